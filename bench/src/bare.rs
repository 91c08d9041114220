//! Drawing with nothing between a program and MuJoCo: an OSMesa context, `mjr_render`,
//! `mjr_readPixels`, and the mean of 2 x 2 pixels. What ours is measured against.
#![allow(unsafe_code, reason = "calls into OSMesa, and makes MuJoCo's renderer on its context")]

use std::ffi::{CStr, c_int, c_uint, c_void};
use std::ptr::null_mut;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context as _, ensure};
use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};
use mujoco_rs::prelude::{
    MjData, MjModel, MjrContext, MjrRectangle, MjvCamera, MjvOption, MjvPerturb, MjvScene,
};

/// The default framebuffer is never drawn to.
const WINDOW_PX: c_int = 16;
/// Of dlfcn.h: a library's own functions come before those that the whole process sees.
const RTLD_DEEPBIND: c_int = 8;
const EXTRA_GEOMS: usize = 64;
// Of MuJoCo's mjtRndFlag.
const SHADOW: usize = 0;
const REFLECTION: usize = 2;

type Create = unsafe extern "C" fn(c_uint, c_int, c_int, c_int, *mut c_void) -> *mut c_void;
type MakeCurrent = unsafe extern "C" fn(*mut c_void, *mut c_void, c_uint, c_int, c_int) -> u8;

/// A thread's own context. It stays to the end of the process.
struct Osmesa;

impl Osmesa {
    fn make_current() -> anyhow::Result<Self> {
        const RGBA: c_uint = 0x1908;
        const UNSIGNED_BYTE: c_uint = 0x1401;
        let named = std::env::var_os("PALR_GYM_OSMESA");
        let names = match named {
            Some(path) => vec![path],
            None => vec!["libOSMesa.so.8".into(), "libOSMesa.so.6".into()],
        };
        // SAFETY: Mesa's libraries do nothing at loading that another thread could mind.
        let open = |name| unsafe { Library::open(Some(name), RTLD_NOW | RTLD_GLOBAL) }.ok();
        // Where MuJoCo finds OpenGL's functions; they work on every copy's contexts.
        std::mem::forget(names.into_iter().find_map(open).context("there is no libOSMesa")?);
        let library = own_copy()?;
        let (create, make_current): (Create, MakeCurrent) = (
            function(&library, c"OSMesaCreateContextExt")?,
            function(&library, c"OSMesaMakeCurrent")?,
        );
        // SAFETY: numbers and a null context to share with, as the header asks for.
        let handle = unsafe { create(RGBA, 24, 8, 0, null_mut()) };
        ensure!(!handle.is_null(), "OSMesaCreateContextExt failed");
        let window = Box::leak(vec![0_u32; (WINDOW_PX * WINDOW_PX) as usize].into_boxed_slice());
        // SAFETY: the window has room for that many pixels and is never freed.
        let is_current = unsafe {
            make_current(handle, window.as_mut_ptr().cast(), UNSIGNED_BYTE, WINDOW_PX, WINDOW_PX)
        };
        ensure!(is_current != 0, "OSMesaMakeCurrent failed");
        std::mem::forget(library);
        Ok(Self)
    }
}

/// OSMesa once more, from a file of its own. Threads that draw with one copy wait for each other.
fn own_copy() -> anyhow::Result<Library> {
    static COPIES: AtomicUsize = AtomicUsize::new(0);
    let maps = std::fs::read_to_string("/proc/self/maps")?;
    let path = maps
        .lines()
        .filter_map(|line| line.find('/').map(|at| &line[at..]))
        .find(|path| path.contains("libOSMesa.so"))
        .context("the loaded libOSMesa has no file")?;
    let number = COPIES.fetch_add(1, Ordering::Relaxed);
    let name = format!("palr-gym-bench-{}-{number}.so", std::process::id());
    let copy = std::env::temp_dir().join(name);
    std::fs::copy(path, &copy)?;
    // SAFETY: as for the first one.
    let library = unsafe { Library::open(Some(&copy), RTLD_NOW | RTLD_LOCAL | RTLD_DEEPBIND) };
    std::fs::remove_file(&copy)?;
    Ok(library?)
}

fn function<T: Copy>(library: &Library, name: &CStr) -> anyhow::Result<T> {
    // SAFETY: the callers state the functions' types as the header declares them.
    Ok(*unsafe { library.get::<T>(name.to_bytes_with_nul()) }?)
}

/// Draws one camera's pictures of a model, on the thread that made it.
pub struct Painter {
    scene: MjvScene,
    context: MjrContext,
    camera: MjvCamera,
    option: MjvOption,
    perturb: MjvPerturb,
    side_px: usize,
    rows: Vec<u8>,
    _gl: Osmesa,
}

impl Painter {
    /// Pictures of `side_px` each way.
    ///
    /// # Errors
    /// Why this thread has no context.
    pub fn new(model: &MjModel, camera: usize, side_px: usize) -> anyhow::Result<Self> {
        let gl = Osmesa::make_current()?;
        let mut scene = MjvScene::new(model, model.ffi().ngeom as usize + EXTRA_GEOMS);
        // SAFETY: flags, which say what is drawn and hold nothing together.
        let flags = unsafe { &mut scene.ffi_mut().flags };
        (flags[SHADOW], flags[REFLECTION]) = (0, 0);
        // SAFETY: the context made above is current on this thread and stays so.
        let mut context = unsafe { MjrContext::new(model) };
        context.resize_offscreen(2 * side_px as u32, 2 * side_px as u32);
        context.offscreen();
        Ok(Self {
            scene,
            context,
            camera: MjvCamera::new_fixed(camera),
            option: MjvOption::default(),
            perturb: MjvPerturb::default(),
            side_px,
            rows: vec![0; 12 * side_px * side_px],
            _gl: gl,
        })
    }

    /// Appends `[side_px, side_px, 3]` of `data`'s positions.
    ///
    /// # Errors
    /// None that a buffer of the right size can cause.
    pub fn paint(
        &mut self,
        data: &mut MjData<Arc<MjModel>>,
        picture: &mut Vec<u8>,
    ) -> anyhow::Result<()> {
        data.kinematics();
        data.com_pos();
        data.camlight();
        self.scene.update(data, &self.option, &self.perturb, &mut self.camera);
        let side = 2 * self.side_px as i32;
        let viewport = MjrRectangle::new(0, 0, side, side);
        self.scene.render(&viewport, &self.context);
        self.context.read_pixels(Some(&mut self.rows), None, &viewport)?;
        let row = 6 * self.side_px;
        for pair in self.rows.chunks_exact(2 * row).rev() {
            let (a, b) = pair.split_at(row);
            for (a, b) in a.chunks_exact(6).zip(b.chunks_exact(6)) {
                picture.extend((0..3).map(|channel| {
                    let cells = [a[channel], a[channel + 3], b[channel], b[channel + 3]];
                    ((cells.map(u16::from).iter().sum::<u16>() + 2) / 4) as u8
                }));
            }
        }
        Ok(())
    }
}
