//! MuJoCo's renderer on a context, one of each for a thread and scene.
#![allow(unsafe_code, reason = "fills MuJoCo's structures for drawing")]

use std::cell::RefCell;
use std::mem::MaybeUninit;
use std::sync::Arc;

use mujoco_rs::mujoco_c::{
    mjr_defaultContext, mjr_freeContext, mjrContext, mjv_averageCamera, mjv_defaultCamera,
    mjv_defaultFreeCamera, mjv_defaultOption, mjv_defaultPerturb, mjv_defaultScene, mjv_freeScene,
    mjv_makeScene, mjvCamera, mjvGeom, mjvOption, mjvPerturb, mjvScene,
};
use mujoco_rs::prelude::{MjData, MjModel, MjtObjBase};

use super::frustum::Frustum;
use super::gl::{self, Context};
use super::{GlChoice, Pieces, RenderError, Weather};
use crate::guard::{self, EngineError};
use crate::physics::Physics;

/// Scenes that a thread keeps ready to draw; the one not used for longest makes room.
const MAX_CANVASES: usize = 8;
/// Room for what MuJoCo draws beside a scene's own geoms.
const EXTRA_GEOMS: usize = 64;
// Indices and values of MuJoCo's enums (mjvisualize.h).
const FLAG_SHADOW: usize = 0;
const FLAG_REFLECTION: usize = 2;
const FLAG_FOG: usize = 5;
const CAMERA_FIXED: i32 = 2;
const OBJECT_GEOM: i32 = 5;
/// The group of pieces that other viewers hide.
const GROUP_OF_PIECES: usize = 3;

thread_local! {
    /// The last used is the last one.
    static CANVASES: RefCell<Vec<Canvas>> = const { RefCell::new(Vec::new()) };
}

/// Start and end in metres, and colour.
type Fog = (f32, f32, [f32; 4]);

/// A scene, ready to be drawn on this thread.
pub(super) struct Canvas {
    model: Arc<MjModel>,
    /// Of the renderer's own: positions are copied here and what is seen follows.
    data: MjData<Arc<MjModel>>,
    scene: Box<mjvScene>,
    context: Box<mjrContext>,
    camera: mjvCamera,
    option: mjvOption,
    perturb: mjvPerturb,
    /// The scene's own fog: start and end in metres, and colour.
    clear: Fog,
    /// The fog of the picture before, if it had any.
    last_fog: Option<Fog>,
    rows: Vec<u8>,
    size: (usize, usize),
    /// Of this scene alone: MuJoCo leaves settings behind in a context, which would show in the
    /// next scene's pictures.
    gl: Context,
}

impl From<EngineError> for RenderError {
    fn from(error: EngineError) -> Self {
        Self::Engine { message: error.message }
    }
}

/// Lends this thread's canvas of `model` to `work`.
pub(super) fn with_canvas<R>(
    choice: GlChoice,
    model: &Arc<MjModel>,
    work: impl FnOnce(&mut Canvas) -> Result<R, RenderError>,
) -> Result<R, RenderError> {
    let loaded = gl::load(choice)?;
    CANVASES.with_borrow_mut(|canvases| {
        let found = canvases.iter().position(|canvas| Arc::ptr_eq(&canvas.model, model));
        let mut canvas = match found {
            Some(index) => {
                let mut canvas = canvases.remove(index);
                canvas.gl.make_current()?;
                canvas
            }
            None => {
                if canvases.len() >= MAX_CANVASES {
                    canvases.remove(0);
                }
                Canvas::new(model, Context::new(loaded)?)?
            }
        };
        let done = work(&mut canvas);
        // What failed inside MuJoCo is not used again.
        if !matches!(done, Err(RenderError::Engine { .. })) {
            canvases.push(canvas);
        }
        done
    })
}

/// Of the model's geom that is drawn here, if it is one.
fn geom_id(geom: &mjvGeom) -> Option<usize> {
    usize::try_from(geom.objid).ok().filter(|_| geom.objtype == OBJECT_GEOM)
}

/// Leaves in a scene what `is_kept` says, in the order it was in.
fn retain_geoms(scene: &mut mjvScene, is_kept: impl Fn(&mjvGeom) -> bool) {
    let count = usize::try_from(scene.ngeom).unwrap_or(0);
    // SAFETY: MuJoCo has filled that many geoms, and nothing else holds them now.
    let geoms = unsafe { std::slice::from_raw_parts_mut(scene.geoms, count) };
    let mut kept = 0;
    for index in 0..count {
        if is_kept(&geoms[index]) {
            geoms.swap(kept, index);
            kept += 1;
        }
    }
    scene.ngeom = kept as i32;
}

/// The names of a scene's cameras.
fn camera_names(model: &MjModel) -> Vec<String> {
    let count = usize::try_from(model.ffi().ncam).unwrap_or(0);
    (0..count)
        .filter_map(|id| model.id_to_name(MjtObjBase::mjOBJ_CAMERA, id))
        .map(str::to_owned)
        .collect()
}

impl Canvas {
    /// `gl` is the thread's current context.
    fn new(model: &Arc<MjModel>, gl: Context) -> Result<Self, RenderError> {
        let data = guard::make_data(model)
            .map_err(|error| RenderError::Engine { message: error.message })?;
        let most = usize::try_from(model.ffi().ngeom).unwrap_or(0) + EXTRA_GEOMS;
        let mut scene = Box::new(MaybeUninit::<mjvScene>::uninit());
        let mut context = Box::new(MaybeUninit::<mjrContext>::uninit());
        let (mut camera, mut option, mut perturb) =
            (MaybeUninit::uninit(), MaybeUninit::uninit(), MaybeUninit::uninit());
        // SAFETY: each call fills the whole structure that it is given, and the model is alive.
        let (mut scene, context, camera, option, perturb) = unsafe {
            mjv_defaultScene(scene.as_mut_ptr());
            mjv_makeScene(model.ffi(), scene.as_mut_ptr(), most as i32);
            mjr_defaultContext(context.as_mut_ptr());
            mjv_defaultCamera(camera.as_mut_ptr());
            mjv_defaultOption(option.as_mut_ptr());
            mjv_defaultPerturb(perturb.as_mut_ptr());
            (
                scene.assume_init(),
                context.assume_init(),
                camera.assume_init(),
                option.assume_init(),
                perturb.assume_init(),
            )
        };
        let mut option = option;
        option.geomgroup[GROUP_OF_PIECES] = u8::from(model.ffi().nuser_geom > 0);
        scene.flags[FLAG_SHADOW] = 0;
        scene.flags[FLAG_REFLECTION] = 0;
        let mut canvas = Self {
            model: Arc::clone(model),
            data,
            scene,
            context,
            camera,
            option,
            perturb,
            clear: (0.0, 0.0, [0.0; 4]),
            last_fog: None,
            rows: Vec::new(),
            size: (0, 0),
            gl,
        };
        guard::make_context(model, &mut canvas.context)?;
        let own = &canvas.context;
        canvas.clear = (own.fogStart, own.fogEnd, own.fogRGBA);
        Ok(canvas)
    }

    /// Takes up where the bodies of `physics` are, and where to look from.
    pub(super) fn pose(
        &mut self,
        physics: &Physics,
        camera: Option<&str>,
    ) -> Result<(), RenderError> {
        let cameras = usize::try_from(self.model.ffi().ncam).unwrap_or(0);
        let id = match camera {
            None => (cameras > 0).then_some(0),
            Some(name) => {
                let id = self.model.name_to_id(MjtObjBase::mjOBJ_CAMERA, name);
                Some(id.ok_or_else(|| RenderError::Camera {
                    got: name.to_owned(),
                    known: camera_names(&self.model),
                })?)
            }
        };
        match id {
            Some(id) => {
                self.camera.type_ = CAMERA_FIXED;
                self.camera.fixedcamid = id as i32;
            }
            // SAFETY: fills the camera from a model that is alive.
            None => unsafe { mjv_defaultFreeCamera(self.model.ffi(), &mut self.camera) },
        }
        self.data.qpos_mut().copy_from_slice(physics.qpos());
        let (positions, quaternions) = physics.mocap();
        self.data.mocap_pos_mut().copy_from_slice(positions);
        self.data.mocap_quat_mut().copy_from_slice(quaternions);
        Ok(guard::update_scene(
            &mut self.data,
            &self.option,
            &self.perturb,
            &mut self.camera,
            &mut self.scene,
        )?)
    }

    /// Takes away what is no part of these pieces.
    pub(super) fn set_pieces(&mut self, pieces: Option<&Pieces>) {
        let Some(pieces) = pieces else { return };
        let numbers = self.model.geom_user();
        retain_geoms(&mut self.scene, |geom| {
            let piece = geom_id(geom).and_then(|id| numbers.get(id));
            piece.is_none_or(|&piece| pieces.contains(piece as usize))
        });
    }

    /// Takes away what a picture of this size does not show.
    pub(super) fn cull(&mut self, width: usize, height: usize) {
        // SAFETY: reads two cameras and makes a third of them: the one that `mjr_render` looks through.
        let camera = unsafe { mjv_averageCamera(&self.scene.camera[0], &self.scene.camera[1]) };
        let Some(frustum) = Frustum::new(&camera, width as f32 / height as f32) else { return };
        let radii = self.model.geom_rbound();
        retain_geoms(&mut self.scene, |geom| {
            let radius = geom_id(geom).and_then(|id| radii.get(id));
            // A plane has no end, and says 0.
            radius.is_none_or(|&radius| radius <= 0.0 || frustum.may_show(geom.pos, radius as f32))
        });
    }

    /// Changes light, fog and colours of what [`pose`](Self::pose) took up.
    pub(super) fn set_weather(&mut self, weather: Option<&Weather>) {
        self.scene.flags[FLAG_FOG] = 0;
        // The haze at the horizon has the fog's colour, fog or not.
        (self.context.fogStart, self.context.fogEnd, self.context.fogRGBA) = self.clear;
        let Some(weather) = weather else { return };
        let lights = usize::try_from(self.scene.nlight).unwrap_or(0);
        for light in self.scene.lights.iter_mut().take(lights) {
            if light.headlight == 0 {
                light.dir = weather.sun_direction;
                light.diffuse = weather.sun;
            } else {
                light.ambient = [weather.ambient; 3];
            }
        }
        let grey = weather.fog_brightness;
        self.context.fogRGBA = [grey, grey, grey, 1.0];
        if let Some((start_m, end_m)) = weather.fog_m {
            self.scene.flags[FLAG_FOG] = 1;
            (self.context.fogStart, self.context.fogEnd) = (start_m, end_m);
        }
        let count = usize::try_from(self.scene.ngeom).unwrap_or(0);
        for (name, factors) in &weather.tints {
            let Some(id) = self.model.name_to_id(MjtObjBase::mjOBJ_MATERIAL, name) else {
                continue;
            };
            // SAFETY: MuJoCo has filled that many geoms, and nothing else holds them now.
            let geoms = unsafe { std::slice::from_raw_parts_mut(self.scene.geoms, count) };
            for geom in geoms.iter_mut().filter(|geom| usize::try_from(geom.matid) == Ok(id)) {
                for (channel, factor) in geom.rgba.iter_mut().zip(factors) {
                    *channel *= factor;
                }
            }
        }
    }

    /// How many geoms are to be drawn.
    #[cfg(test)]
    pub(super) fn geoms(&self) -> i32 {
        self.scene.ngeom
    }

    /// `[height, width, 3]`, from the lowest row up.
    pub(super) fn draw(&mut self, width: usize, height: usize) -> Result<&[u8], RenderError> {
        if self.size != (width, height) {
            guard::resize(&mut self.context, width, height)?;
            self.size = (width, height);
        }
        self.rows.resize(width * height * 3, 0);
        let context = &self.context;
        let fog = (self.scene.flags[FLAG_FOG] == 1).then_some((
            context.fogStart,
            context.fogEnd,
            context.fogRGBA,
        ));
        // Some of the first picture with another fog still has the fog of the one before.
        if fog.is_some() && fog != self.last_fog {
            let size = (width, height);
            guard::draw(&mut self.scene, &mut self.context, size, &mut self.rows)?;
        }
        self.last_fog = fog;
        guard::draw(&mut self.scene, &mut self.context, (width, height), &mut self.rows)?;
        Ok(&self.rows)
    }
}

impl Drop for Canvas {
    fn drop(&mut self) {
        if gl::is_left() || self.gl.make_current().is_err() {
            // What cannot be freed goes with its context.
            return;
        }
        // SAFETY: both were made by `new` on this thread, in the context that is current.
        unsafe {
            mjr_freeContext(&mut *self.context);
            mjv_freeScene(&mut *self.scene);
        }
    }
}
