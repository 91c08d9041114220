//! OpenGL contexts without a screen, from libraries that are looked for at run time.
//!
//! Mesa's software renderer rasterises under a lock of its *screen*, and a loaded library has one
//! screen (EGL: a display has one). Threads on the same screen draw one after the other. So each
//! drawing thread gets an [`Instance`] with a screen of its own, as far as there are processors and
//! the library can give more than one.
#![allow(unsafe_code, reason = "asks OpenGL what it is")]

mod egl;
mod osmesa;

use std::cell::OnceCell;
use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use self::egl::Egl;
use self::osmesa::Osmesa;
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

/// A library that is there: where contexts come from.
trait Source: Send + Sync {
    fn library(&self) -> GlLibrary;

    /// Finds a function of OpenGL. It works on whatever context is current, of any instance.
    fn get(&self) -> GetFunction;

    /// Instance `number`, counted from 0.
    fn instance(&self, number: usize) -> Result<Arc<dyn Instance>, String>;
}

/// What threads that share it draw on one after the other.
trait Instance: Send + Sync {
    /// A new context of this thread, current.
    fn context(&self) -> Result<Box<dyn ThreadContext>, String>;
}

/// A context of one thread. Dropped, it is destroyed, and no longer current.
trait ThreadContext {
    fn make_current(&mut self) -> bool;
}

/// A library that is loaded and works.
pub(super) struct Loaded {
    source: Box<dyn Source>,
    info: GlInfo,
    instances: Mutex<Instances>,
}

struct Instances {
    /// An instance is held by this list and by each thread that draws on it.
    list: Vec<Arc<dyn Instance>>,
    can_grow: bool,
}

thread_local! {
    /// Where this thread draws. A process has one library, so it is the same for every scene.
    static MINE: OnceCell<Arc<dyn Instance>> = const { OnceCell::new() };
}

impl Loaded {
    /// A library counts only if it gives a context.
    fn new(source: Box<dyn Source>) -> Result<Self, String> {
        let first = source.instance(0)?;
        let context = first.context()?;
        let info = current(source.as_ref());
        drop(context);
        let instances = Mutex::new(Instances { list: vec![first], can_grow: true });
        Ok(Self { source, info, instances })
    }

    pub(super) fn library(&self) -> GlLibrary {
        self.source.library()
    }

    fn instance(&self) -> Arc<dyn Instance> {
        MINE.with(|mine| Arc::clone(mine.get_or_init(|| self.choose())))
    }

    /// The instance that fewest threads draw on: a new one, if all are taken and it is worth it.
    fn choose(&self) -> Arc<dyn Instance> {
        let most = std::thread::available_parallelism().map_or(1, usize::from);
        let mut instances = self.instances.lock().unwrap_or_else(PoisonError::into_inner);
        let is_free = |instance: &Arc<dyn Instance>| Arc::strong_count(instance) == 1;
        let Instances { list, can_grow } = &mut *instances;
        if *can_grow && list.len() < most && !list.iter().any(is_free) {
            match self.another(list.len()) {
                Ok(another) => list.push(another),
                Err(message) => {
                    *can_grow = false;
                    tracing::debug!(library = self.library().name(), message, "threads share one");
                }
            }
        }
        let fewest = list.iter().min_by_key(|instance| Arc::strong_count(instance));
        Arc::clone(fewest.unwrap_or(&list[0]))
    }

    /// It must draw as the first one does, through the functions that MuJoCo has found there.
    fn another(&self, number: usize) -> Result<Arc<dyn Instance>, String> {
        let another = self.source.instance(number)?;
        let context = another.context()?;
        let info = current(self.source.as_ref());
        drop(context);
        if info == self.info {
            Ok(another)
        } else {
            Err(format!("instance {number} draws with {info:?}, not {:?}", self.info))
        }
    }
}

/// Asks the current context what it is.
fn current(source: &dyn Source) -> GlInfo {
    const RENDERER: c_uint = 0x1F01;
    const VERSION: c_uint = 0x1F02;
    GlInfo {
        library: source.library().name(),
        renderer: string(source.get(), RENDERER),
        version: string(source.get(), VERSION),
    }
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
    // SAFETY: the text is OpenGL's own, terminated, or null: without a context, for one.
    let text = unsafe { get_string(name) };
    if text.is_null() {
        return String::new();
    }
    // SAFETY: not null, as just seen.
    unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
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
        let source: Result<Box<dyn Source>, String> = match library {
            GlLibrary::Osmesa => Osmesa::load().map(|found| Box::new(found) as _),
            GlLibrary::Egl => Egl::load(choice == GlChoice::Egl).map(|found| Box::new(found) as _),
        };
        match source.and_then(Loaded::new) {
            Ok(found) => {
                let found: &'static Loaded = Box::leak(Box::new(found));
                *loaded = Some(found);
                INFO.get_or_init(|| found.info.clone());
                return Ok(found);
            }
            Err(message) => tried.push(message),
        }
    }
    Err(RenderError::NoGl { tried: tried.join("; ") })
}

/// An OpenGL context of one thread, current when it was just made.
pub(super) struct Context {
    library: GlLibrary,
    context: Box<dyn ThreadContext>,
}

impl Context {
    pub(super) fn new(loaded: &'static Loaded) -> Result<Self, RenderError> {
        let library = loaded.library();
        let context = loaded
            .instance()
            .context()
            .map_err(|message| RenderError::Context { library: library.name(), message })?;
        Ok(Self { library, context })
    }

    /// Makes this the thread's current context.
    pub(super) fn make_current(&mut self) -> Result<(), RenderError> {
        if self.context.make_current() {
            return Ok(());
        }
        let message = "it cannot be made current".to_owned();
        Err(RenderError::Context { library: self.library.name(), message })
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

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn threads_share_what_they_draw_on_only_where_processors_or_displays_run_out() {
        let loaded = match load(GlChoice::Auto) {
            Ok(loaded) => loaded,
            Err(error) => return eprintln!("SKIPPED: {error}"),
        };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let most = match loaded.library() {
            GlLibrary::Osmesa => processors,
            GlLibrary::Egl => processors.min(2),
        };
        // Nobody gives theirs back before all have one.
        let barrier = Barrier::new(most);
        let mine = || {
            let mine = Arc::as_ptr(&loaded.instance()).cast::<()>() as usize;
            barrier.wait();
            mine
        };
        let mut all = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..most).map(|_| scope.spawn(mine)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
        });
        all.sort_unstable();
        all.dedup();
        let in_all = loaded.instances.lock().unwrap().list.len();
        // Other tests of this process may hold some.
        assert!(all.len() == most || in_all == most, "{} of {most}, {in_all}", all.len());
    }
}
