//! OpenGL contexts without a screen, from libraries that are looked for at run time.
#![allow(unsafe_code, reason = "calls into OSMesa and EGL")]

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::path::{Path, PathBuf};
use std::ptr::{null, null_mut};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use super::{GlChoice, RenderError};

/// The default framebuffer is never drawn to, so it may be small.
const WINDOW_PX: c_int = 16;

/// What a process draws with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GlInfo {
    /// `osmesa` or `egl`.
    pub library: &'static str,
    /// As OpenGL names it (`GL_RENDERER`).
    pub renderer: String,
    /// With Mesa's version (`GL_VERSION`).
    pub version: String,
}

/// A library that gives contexts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GlLibrary {
    /// Mesa's off-screen library.
    Osmesa,
    /// EGL.
    Egl,
}

impl GlLibrary {
    /// The word for it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Osmesa => "osmesa",
            Self::Egl => "egl",
        }
    }
}

static LOADED: Mutex<Option<&'static Loaded>> = Mutex::new(None);
static INFO: OnceLock<GlInfo> = OnceLock::new();

/// Sets what Mesa reads from the environment: it must not start threads of its own for each
/// context, for our threads are as many as the machine can use. To be called first thing in `main`;
/// with other threads about it does nothing.
pub fn prepare_process() {
    let threads = std::fs::read_dir("/proc/self/task").map_or(0, Iterator::count);
    if threads == 1 && std::env::var_os("LP_NUM_THREADS").is_none() {
        // SAFETY: this is the only thread, so nobody else reads the environment meanwhile.
        unsafe { std::env::set_var("LP_NUM_THREADS", "0") };
    }
}

pub(super) fn info() -> Option<GlInfo> {
    INFO.get().cloned()
}

/// Asks the current context what it is. The first answer stays: a process has one library.
pub(super) fn remember_info(loaded: &Loaded) {
    const RENDERER: c_uint = 0x1F01;
    const VERSION: c_uint = 0x1F02;
    let text = |name| match loaded {
        Loaded::Osmesa(Osmesa { get, .. }) | Loaded::Egl(Egl { get, .. }) => string(*get, name),
    };
    INFO.get_or_init(|| GlInfo {
        library: loaded.library().name(),
        renderer: text(RENDERER),
        version: text(VERSION),
    });
}

/// `glGetString`.
fn string(get: GetFunction, name: c_uint) -> String {
    // SAFETY: a terminated text.
    let found = unsafe { get(c"glGetString".as_ptr()) };
    if found.is_null() {
        return String::new();
    }
    // SAFETY: this is how OpenGL declares the function.
    let get_string = unsafe {
        std::mem::transmute::<*const c_void, unsafe extern "C" fn(c_uint) -> *const c_char>(found)
    };
    // SAFETY: a context is current; the text is OpenGL's own, terminated, or null.
    let text = unsafe { get_string(name) };
    if text.is_null() {
        return String::new();
    }
    // SAFETY: not null, as just seen.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
}

/// A library that is loaded and works.
pub(super) enum Loaded {
    Osmesa(Osmesa),
    Egl(Egl),
}

impl Loaded {
    pub(super) fn library(&self) -> GlLibrary {
        match self {
            Self::Osmesa(_) => GlLibrary::Osmesa,
            Self::Egl(_) => GlLibrary::Egl,
        }
    }
}

/// The process's library, loaded if this is the first time. MuJoCo finds OpenGL's functions once,
/// so there is only one; what failed is tried again the next time.
pub(super) fn load(choice: GlChoice) -> Result<&'static Loaded, RenderError> {
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    let wanted: &[GlLibrary] = match choice {
        GlChoice::None => return Err(RenderError::Disabled),
        GlChoice::Auto => &[GlLibrary::Osmesa, GlLibrary::Egl],
        GlChoice::Osmesa => &[GlLibrary::Osmesa],
        GlChoice::Egl => &[GlLibrary::Egl],
    };
    if let Some(loaded) = *loaded {
        return if wanted.contains(&loaded.library()) {
            Ok(loaded)
        } else {
            Err(RenderError::OtherLibrary { loaded: loaded.library().name(), asked: choice.name() })
        };
    }
    let mut tried = Vec::new();
    for library in wanted {
        let attempt = match library {
            GlLibrary::Osmesa => Osmesa::load().map(Loaded::Osmesa),
            GlLibrary::Egl => Egl::load(choice == GlChoice::Egl).map(Loaded::Egl),
        };
        // A library counts only if it gives a context.
        match attempt.and_then(|found| Context::of(&found).map(|_| ()).map(|()| found)) {
            Ok(found) => {
                let found: &'static Loaded = Box::leak(Box::new(found));
                *loaded = Some(found);
                return Ok(found);
            }
            Err(message) => tried.push(message),
        }
    }
    Err(RenderError::NoGl { tried: tried.join("; ") })
}

/// An OpenGL context of one thread, current when it was just made.
pub(super) enum Context {
    Osmesa { api: OsmesaApi, handle: *mut c_void, window: Box<[u32]> },
    Egl { api: EglApi, display: *mut c_void, handle: *mut c_void, surface: *mut c_void },
}

impl Context {
    pub(super) fn new(loaded: &'static Loaded) -> Result<Self, RenderError> {
        Self::of(loaded)
            .map_err(|message| RenderError::Context { library: loaded.library().name(), message })
    }

    /// Makes this the thread's current context.
    pub(super) fn make_current(&mut self) -> Result<(), RenderError> {
        const UNSIGNED_BYTE: c_uint = 0x1401;
        let (library, is_current) = match self {
            Self::Osmesa { api, handle, window } => {
                let pixels = window.as_mut_ptr().cast();
                // SAFETY: the window has room for that many pixels and lives as long as the
                // context, which is this thread's own.
                let is_current = unsafe {
                    (api.make_current)(*handle, pixels, UNSIGNED_BYTE, WINDOW_PX, WINDOW_PX)
                };
                (GlLibrary::Osmesa, is_current != 0)
            }
            Self::Egl { api, display, handle, surface } => {
                // SAFETY: display, context and surface belong together, and are this thread's own.
                let is_current =
                    unsafe { (api.make_current)(*display, *surface, *surface, *handle) };
                (GlLibrary::Egl, is_current != 0)
            }
        };
        let message = || "it cannot be made current".to_owned();
        if is_current {
            Ok(())
        } else {
            Err(RenderError::Context { library: library.name(), message: message() })
        }
    }

    fn of(loaded: &Loaded) -> Result<Self, String> {
        match loaded {
            Loaded::Osmesa(osmesa) => osmesa.context(),
            Loaded::Egl(egl) => egl.context(),
        }
    }
}

/// True once the process is about to end: the library may be gone.
static IS_LEFT: AtomicBool = AtomicBool::new(false);

pub(super) fn leave() {
    IS_LEFT.store(true, Ordering::SeqCst);
}

pub(super) fn is_left() -> bool {
    IS_LEFT.load(Ordering::SeqCst)
}

impl Drop for Context {
    fn drop(&mut self) {
        if is_left() {
            return;
        }
        match self {
            Self::Osmesa { api, handle, .. } => {
                // SAFETY: the context is this thread's own and was made by the same library, which
                // is never unloaded; its window lives until after this.
                unsafe {
                    (api.make_current)(null_mut(), null_mut(), 0, 0, 0);
                    (api.destroy)(*handle);
                }
            }
            Self::Egl { api, display, handle, surface } => {
                // SAFETY: as above; display, context and surface belong together.
                unsafe {
                    (api.make_current)(*display, null_mut(), null_mut(), null_mut());
                    (api.destroy_surface)(*display, *surface);
                    (api.destroy_context)(*display, *handle);
                }
            }
        }
    }
}

/// Opens a library so that MuJoCo, which looks in the whole process, finds its functions.
fn open(path: &Path) -> Result<Library, String> {
    // SAFETY: system libraries of OpenGL; their initialisers may run at any time.
    unsafe { Library::open(Some(path), RTLD_NOW | RTLD_GLOBAL) }
        .map_err(|error| format!("{}: {error}", path.display()))
}

/// The function `name` of a library.
fn function<T: Copy>(library: &Library, name: &CStr) -> Result<T, String> {
    // SAFETY: each caller states the function's type as its header declares it.
    unsafe { library.get::<T>(name.to_bytes_with_nul()) }
        .map(|found| *found)
        .map_err(|error| error.to_string())
}

/// Finds a function of OpenGL by its name.
type GetFunction = unsafe extern "C" fn(*const c_char) -> *const c_void;

#[derive(Clone, Copy)]
pub(super) struct OsmesaApi {
    create: unsafe extern "C" fn(c_uint, c_int, c_int, c_int, *mut c_void) -> *mut c_void,
    make_current: unsafe extern "C" fn(*mut c_void, *mut c_void, c_uint, c_int, c_int) -> u8,
    destroy: unsafe extern "C" fn(*mut c_void),
}

pub(super) struct Osmesa {
    api: OsmesaApi,
    get: GetFunction,
    /// Never unloaded.
    _libraries: Vec<Library>,
}

impl Osmesa {
    /// `$PALR_GYM_OSMESA` alone if it is set; else the system's, else the one that set-up fetched.
    fn load() -> Result<Self, String> {
        let mut failures = Vec::new();
        let own = Path::new(env!("PALR_GYM_NATIVE_DIR")).join("../gl");
        let candidates = match std::env::var_os("PALR_GYM_OSMESA") {
            Some(path) => vec![PathBuf::from(path)],
            None => {
                let names = ["libOSMesa.so.8", "libOSMesa.so.6"];
                let own = names.map(|name| own.join(name));
                names.map(PathBuf::from).into_iter().chain(own).collect()
            }
        };
        for path in candidates {
            let mut libraries = Vec::new();
            if path.starts_with(&own) {
                if !path.exists() {
                    continue;
                }
                libraries = open_all(&own);
            }
            let api = open(&path).and_then(|library| {
                let api = OsmesaApi {
                    create: function(&library, c"OSMesaCreateContextExt")?,
                    make_current: function(&library, c"OSMesaMakeCurrent")?,
                    destroy: function(&library, c"OSMesaDestroyContext")?,
                };
                let get: GetFunction = function(&library, c"OSMesaGetProcAddress")?;
                libraries.push(library);
                Ok((api, get))
            });
            match api {
                Ok((api, get)) => return Ok(Self { api, get, _libraries: libraries }),
                Err(message) => failures.push(message),
            }
        }
        Err(failures.join(", "))
    }

    fn context(&self) -> Result<Context, String> {
        const RGBA: c_uint = 0x1908;
        const UNSIGNED_BYTE: c_uint = 0x1401;
        let api = self.api;
        let mut window = vec![0_u32; (WINDOW_PX * WINDOW_PX) as usize].into_boxed_slice();
        // SAFETY: numbers and a null context to share with, as the header asks for.
        let handle = unsafe { (api.create)(RGBA, 24, 8, 0, null_mut()) };
        if handle.is_null() {
            return Err("OSMesaCreateContextExt failed".into());
        }
        let pixels = window.as_mut_ptr().cast();
        let context = Context::Osmesa { api, handle, window };
        // SAFETY: the window has room for that many pixels and lives as long as the context.
        let is_current =
            unsafe { (api.make_current)(handle, pixels, UNSIGNED_BYTE, WINDOW_PX, WINDOW_PX) };
        if is_current == 0 { Err("OSMesaMakeCurrent failed".into()) } else { Ok(context) }
    }
}

/// Opens every library in a folder, those first on which others depend: the loader then knows them
/// by name. What cannot be opened is left for the loader to complain about.
fn open_all(folder: &Path) -> Vec<Library> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut waiting: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    waiting.sort();
    let mut opened = Vec::new();
    loop {
        let before = opened.len();
        waiting.retain(|path| match open(path) {
            Ok(library) => {
                opened.push(library);
                false
            }
            Err(_) => true,
        });
        if opened.len() == before {
            return opened;
        }
    }
}

type EglDisplay = *mut c_void;

#[derive(Clone, Copy)]
pub(super) struct EglApi {
    create_context:
        unsafe extern "C" fn(EglDisplay, *mut c_void, *mut c_void, *const c_int) -> *mut c_void,
    create_pbuffer: unsafe extern "C" fn(EglDisplay, *mut c_void, *const c_int) -> *mut c_void,
    make_current: unsafe extern "C" fn(EglDisplay, *mut c_void, *mut c_void, *mut c_void) -> c_uint,
    destroy_context: unsafe extern "C" fn(EglDisplay, *mut c_void) -> c_uint,
    destroy_surface: unsafe extern "C" fn(EglDisplay, *mut c_void) -> c_uint,
    bind_api: unsafe extern "C" fn(c_uint) -> c_uint,
    get_error: unsafe extern "C" fn() -> c_int,
}

pub(super) struct Egl {
    api: EglApi,
    get: GetFunction,
    display: EglDisplay,
    config: *mut c_void,
    /// Never unloaded.
    _library: Library,
}

// SAFETY: EGL's displays and configurations may be used by any thread; they are never freed.
unsafe impl Send for Loaded {}
// SAFETY: as above.
unsafe impl Sync for Loaded {}

impl Egl {
    fn load(may_use_hardware: bool) -> Result<Self, String> {
        const EXTENSIONS: c_int = 0x3055;
        const PLATFORM_DEVICE: c_uint = 0x313F;
        const PLATFORM_SURFACELESS: c_uint = 0x31DD;
        let library = open(Path::new("libEGL.so.1"))?;
        let get: GetFunction = function(&library, c"eglGetProcAddress")?;
        let extension = |name: &CStr| {
            // SAFETY: a terminated text.
            let found = unsafe { get(name.as_ptr()) };
            if found.is_null() {
                Err(format!("libEGL.so.1 is too old: it has no {}", name.to_string_lossy()))
            } else {
                Ok(found)
            }
        };
        type QueryDevices = unsafe extern "C" fn(c_int, *mut *mut c_void, *mut c_int) -> c_uint;
        type DeviceString = unsafe extern "C" fn(*mut c_void, c_int) -> *const c_char;
        type PlatformDisplay =
            unsafe extern "C" fn(c_uint, *mut c_void, *const c_int) -> EglDisplay;
        // SAFETY: these are the types under which the extensions declare them.
        let (query_devices, device_string, platform_display) = unsafe {
            (
                std::mem::transmute::<*const c_void, QueryDevices>(extension(
                    c"eglQueryDevicesEXT",
                )?),
                std::mem::transmute::<*const c_void, DeviceString>(extension(
                    c"eglQueryDeviceStringEXT",
                )?),
                std::mem::transmute::<*const c_void, PlatformDisplay>(extension(
                    c"eglGetPlatformDisplayEXT",
                )?),
            )
        };
        let mut devices = [null_mut(); 32];
        let mut count = 0;
        // SAFETY: room for as many devices as it is told.
        unsafe { query_devices(devices.len() as c_int, devices.as_mut_ptr(), &mut count) };
        let devices = &devices[..count.clamp(0, 32) as usize];
        let is_software = |device: &&*mut c_void| {
            // SAFETY: a device that EGL has just named; the text is EGL's own and terminated.
            let text = unsafe { device_string(**device, EXTENSIONS) };
            // SAFETY: as above; checked for null first.
            !text.is_null()
                && unsafe { CStr::from_ptr(text) }
                    .to_string_lossy()
                    .contains("EGL_MESA_device_software")
        };
        let software = devices.iter().find(is_software).copied();
        let hardware = devices.first().copied().filter(|_| may_use_hardware);
        // SAFETY: a platform with its kind of native display, and no attributes.
        let display = unsafe {
            match software.or(hardware) {
                Some(device) => platform_display(PLATFORM_DEVICE, device, null()),
                None => platform_display(PLATFORM_SURFACELESS, null_mut(), null()),
            }
        };
        let initialize: unsafe extern "C" fn(EglDisplay, *mut c_int, *mut c_int) -> c_uint =
            function(&library, c"eglInitialize")?;
        let choose: unsafe extern "C" fn(
            EglDisplay,
            *const c_int,
            *mut *mut c_void,
            c_int,
            *mut c_int,
        ) -> c_uint = function(&library, c"eglChooseConfig")?;
        let api = EglApi {
            create_context: function(&library, c"eglCreateContext")?,
            create_pbuffer: function(&library, c"eglCreatePbufferSurface")?,
            make_current: function(&library, c"eglMakeCurrent")?,
            destroy_context: function(&library, c"eglDestroyContext")?,
            destroy_surface: function(&library, c"eglDestroySurface")?,
            bind_api: function(&library, c"eglBindAPI")?,
            get_error: function(&library, c"eglGetError")?,
        };
        // Red, green, blue, alpha, depth and stencil bits; a pbuffer; OpenGL.
        let wanted = [
            0x3024, 8, 0x3023, 8, 0x3022, 8, 0x3021, 8, 0x3025, 24, 0x3026, 8, 0x3033, 1, 0x3040,
            8, 0x3038,
        ];
        let (mut config, mut found) = (null_mut(), 0);
        // SAFETY: the display may be null, which EGL reports; the lists are terminated.
        let is_ready = unsafe {
            initialize(display, null_mut(), null_mut()) != 0
                && choose(display, wanted.as_ptr(), &mut config, 1, &mut found) != 0
                && found > 0
        };
        if !is_ready {
            // SAFETY: takes nothing.
            let code = unsafe { (api.get_error)() };
            return Err(format!("EGL has no display that draws OpenGL off screen ({code:#06x})"));
        }
        Ok(Self { api, get, display, config, _library: library })
    }

    fn context(&self) -> Result<Context, String> {
        const OPENGL: c_uint = 0x30A2;
        let (api, display) = (self.api, self.display);
        let size = [0x3057, WINDOW_PX, 0x3056, WINDOW_PX, 0x3038];
        // SAFETY: display and configuration are those of `load`; the lists are terminated.
        unsafe {
            (api.bind_api)(OPENGL);
            let surface = (api.create_pbuffer)(display, self.config, size.as_ptr());
            let handle = (api.create_context)(display, self.config, null_mut(), null());
            let context = Context::Egl { api, display, handle, surface };
            if surface.is_null()
                || handle.is_null()
                || (api.make_current)(display, surface, surface, handle) == 0
            {
                return Err(format!("EGL error {:#06x}", (api.get_error)()));
            }
            Ok(context)
        }
    }
}
