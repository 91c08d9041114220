//! OSMesa. Every instance is a copy of the library, loaded beside the others: only so does it have a
//! screen of its own. OpenGL's functions are those of the one `libglapi` that all copies share; they
//! go to the current context's copy.
#![allow(unsafe_code, reason = "calls into OSMesa")]

use std::ffi::{CStr, OsStr, c_int, c_uint, c_void};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::{AsRawFd, FromRawFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::ptr::null_mut;
use std::sync::{Arc, Mutex, PoisonError};

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use super::{
    GetFunction, GlLibrary, Instance, Source, ThreadContext, WINDOW_PX, function, is_left, open,
};

const RGBA: c_uint = 0x1908;
const UNSIGNED_BYTE: c_uint = 0x1401;

pub(super) struct Osmesa {
    first: Api,
    get: GetFunction,
    /// Never unloaded.
    _libraries: Vec<Library>,
}

#[derive(Clone, Copy)]
struct Api {
    create: unsafe extern "C" fn(c_uint, c_int, c_int, c_int, *mut c_void) -> *mut c_void,
    make_current: unsafe extern "C" fn(*mut c_void, *mut c_void, c_uint, c_int, c_int) -> u8,
    destroy: unsafe extern "C" fn(*mut c_void),
}

impl Api {
    fn of(library: &Library) -> Result<Self, String> {
        Ok(Self {
            create: function(library, c"OSMesaCreateContextExt")?,
            make_current: function(library, c"OSMesaMakeCurrent")?,
            destroy: function(library, c"OSMesaDestroyContext")?,
        })
    }
}

impl Osmesa {
    /// `$PALR_GYM_OSMESA` alone if it is set; else the system's, else the one that set-up fetched.
    pub(super) fn load() -> Result<Self, String> {
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
            let found = open(&path).and_then(|library| {
                let first = Api::of(&library)?;
                let get: GetFunction = function(&library, c"OSMesaGetProcAddress")?;
                libraries.push(library);
                Ok((first, get))
            });
            match found {
                Ok((first, get)) => return Ok(Self { first, get, _libraries: libraries }),
                Err(message) => failures.push(message),
            }
        }
        Err(failures.join(", "))
    }

    /// Loads the library's file once more. The loader knows files by their inode, so the copy is
    /// another file, in memory; the library stays loaded, and so does the file.
    fn copy(&self) -> io::Result<Library> {
        let library = std::fs::read(file_of(self.first.destroy as *const c_void)?)?;
        // SAFETY: a terminated name; the descriptor is closed at the program's end and by `File`.
        let mut file = unsafe {
            let descriptor = libc::memfd_create(c"libOSMesa".as_ptr(), libc::MFD_CLOEXEC);
            if descriptor < 0 {
                return Err(io::Error::last_os_error());
            }
            File::from_raw_fd(descriptor)
        };
        file.write_all(&library)?;
        let path = format!("/proc/self/fd/{}", file.as_raw_fd());
        // Its own functions come before those of the first copy, which the whole process sees.
        let flags = RTLD_NOW | RTLD_LOCAL | libc::RTLD_DEEPBIND;
        // SAFETY: what `load` has loaded once already.
        unsafe { Library::open(Some(path), flags) }.map_err(io::Error::other)
    }
}

impl Source for Osmesa {
    fn library(&self) -> GlLibrary {
        GlLibrary::Osmesa
    }

    fn get(&self) -> GetFunction {
        self.get
    }

    fn instance(&self, number: usize) -> Result<Arc<dyn Instance>, String> {
        if number == 0 {
            return Ok(Arc::new(self.first));
        }
        let library = self.copy().map_err(|error| error.to_string())?;
        let api = Api::of(&library)?;
        // Never unloaded.
        std::mem::forget(library);
        Ok(Arc::new(api))
    }
}

/// The file that a function was loaded from.
fn file_of(function: *const c_void) -> io::Result<PathBuf> {
    let mut found = std::mem::MaybeUninit::<libc::Dl_info>::uninit();
    // SAFETY: fills the structure unless it returns 0; the name is the loader's own, terminated, and
    // stays while the library is loaded.
    unsafe {
        if libc::dladdr(function, found.as_mut_ptr()) == 0 {
            return Err(io::Error::other("the loader does not know OSMesa's functions"));
        }
        let name = CStr::from_ptr(found.assume_init().dli_fname);
        Ok(Path::new(OsStr::from_bytes(name.to_bytes())).to_owned())
    }
}

impl Instance for Api {
    fn context(&self) -> Result<Box<dyn ThreadContext>, String> {
        /// A copy's first context starts the code generator, which all copies share.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: numbers and a null context to share with, as the header asks for.
        let handle = unsafe { (self.create)(RGBA, 24, 8, 0, null_mut()) };
        if handle.is_null() {
            return Err("OSMesaCreateContextExt failed".into());
        }
        let window = vec![0_u32; (WINDOW_PX * WINDOW_PX) as usize].into_boxed_slice();
        let mut context = Box::new(OsmesaContext { api: *self, handle, window });
        if context.make_current() { Ok(context) } else { Err("OSMesaMakeCurrent failed".into()) }
    }
}

struct OsmesaContext {
    api: Api,
    handle: *mut c_void,
    window: Box<[u32]>,
}

impl ThreadContext for OsmesaContext {
    fn make_current(&mut self) -> bool {
        let pixels = self.window.as_mut_ptr().cast();
        // SAFETY: the window has room for that many pixels and lives as long as the context, which
        // is this thread's own.
        let is_current = unsafe {
            (self.api.make_current)(self.handle, pixels, UNSIGNED_BYTE, WINDOW_PX, WINDOW_PX)
        };
        is_current != 0
    }
}

impl Drop for OsmesaContext {
    fn drop(&mut self) {
        if is_left() {
            return;
        }
        // SAFETY: the context is this thread's own and was made by the same library, which is never
        // unloaded; its window lives until after this.
        unsafe {
            (self.api.make_current)(null_mut(), null_mut(), 0, 0, 0);
            (self.api.destroy)(self.handle);
        }
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
