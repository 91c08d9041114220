//! EGL. Every instance is a display: Mesa's driver keeps a screen for each. There are two for the
//! processor: the software device and the platform without a surface.
#![allow(unsafe_code, reason = "calls into EGL")]

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::path::Path;
use std::ptr::{null, null_mut};
use std::sync::Arc;

use libloading::os::unix::Library;

use super::{
    GetFunction, GlLibrary, Instance, Source, ThreadContext, WINDOW_PX, function, is_left, open,
};

/// As EGL numbers things (egl.h, eglext.h); `NONE` ends a list.
mod number {
    use super::{c_int, c_uint};

    pub(super) const NONE: c_int = 0x3038;
    pub(super) const WIDTH: c_int = 0x3057;
    pub(super) const HEIGHT: c_int = 0x3056;
    pub(super) const EXTENSIONS: c_int = 0x3055;
    pub(super) const OPENGL_API: c_uint = 0x30A2;
    pub(super) const PLATFORM_DEVICE: c_uint = 0x313F;
    pub(super) const PLATFORM_SURFACELESS: c_uint = 0x31DD;
    /// Red, green, blue, alpha, depth and stencil bits; a pbuffer; OpenGL.
    pub(super) const CONFIG: [c_int; 17] = [
        0x3024, 8, 0x3023, 8, 0x3022, 8, 0x3021, 8, 0x3025, 24, 0x3026, 8, 0x3033, 1, 0x3040, 8,
        NONE,
    ];
}

type RawDisplay = *mut c_void;
type QueryDevices = unsafe extern "C" fn(c_int, *mut *mut c_void, *mut c_int) -> c_uint;
type DeviceString = unsafe extern "C" fn(*mut c_void, c_int) -> *const c_char;
type PlatformDisplay = unsafe extern "C" fn(c_uint, *mut c_void, *const c_int) -> RawDisplay;

#[derive(Clone, Copy)]
struct Api {
    initialize: unsafe extern "C" fn(RawDisplay, *mut c_int, *mut c_int) -> c_uint,
    choose_config: unsafe extern "C" fn(
        RawDisplay,
        *const c_int,
        *mut *mut c_void,
        c_int,
        *mut c_int,
    ) -> c_uint,
    create_context:
        unsafe extern "C" fn(RawDisplay, *mut c_void, *mut c_void, *const c_int) -> *mut c_void,
    create_pbuffer: unsafe extern "C" fn(RawDisplay, *mut c_void, *const c_int) -> *mut c_void,
    make_current: unsafe extern "C" fn(RawDisplay, *mut c_void, *mut c_void, *mut c_void) -> c_uint,
    destroy_context: unsafe extern "C" fn(RawDisplay, *mut c_void) -> c_uint,
    destroy_surface: unsafe extern "C" fn(RawDisplay, *mut c_void) -> c_uint,
    bind_api: unsafe extern "C" fn(c_uint) -> c_uint,
    get_error: unsafe extern "C" fn() -> c_int,
}

pub(super) struct Egl {
    api: Api,
    get: GetFunction,
    platform_display: PlatformDisplay,
    device: Device,
    /// Never unloaded.
    _library: Library,
}

/// What the first display is of.
#[derive(Clone, Copy)]
enum Device {
    Software(*mut c_void),
    Hardware(*mut c_void),
    /// EGL names none, or none that may be used.
    Unnamed,
}

// SAFETY: EGL's devices may be used by any thread; they are never freed.
unsafe impl Send for Egl {}
// SAFETY: as above.
unsafe impl Sync for Egl {}

impl Egl {
    pub(super) fn load(may_use_hardware: bool) -> Result<Self, String> {
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
            let text = unsafe { device_string(**device, number::EXTENSIONS) };
            // SAFETY: as above; checked for null first.
            !text.is_null()
                && unsafe { CStr::from_ptr(text) }
                    .to_string_lossy()
                    .contains("EGL_MESA_device_software")
        };
        let software = devices.iter().find(is_software).copied().map(Device::Software);
        let hardware = devices.first().copied().filter(|_| may_use_hardware).map(Device::Hardware);
        let api = Api {
            initialize: function(&library, c"eglInitialize")?,
            choose_config: function(&library, c"eglChooseConfig")?,
            create_context: function(&library, c"eglCreateContext")?,
            create_pbuffer: function(&library, c"eglCreatePbufferSurface")?,
            make_current: function(&library, c"eglMakeCurrent")?,
            destroy_context: function(&library, c"eglDestroyContext")?,
            destroy_surface: function(&library, c"eglDestroySurface")?,
            bind_api: function(&library, c"eglBindAPI")?,
            get_error: function(&library, c"eglGetError")?,
        };
        let device = software.or(hardware).unwrap_or(Device::Unnamed);
        Ok(Self { api, get, platform_display, device, _library: library })
    }
}

impl Source for Egl {
    fn library(&self) -> GlLibrary {
        GlLibrary::Egl
    }

    fn get(&self) -> GetFunction {
        self.get
    }

    fn instance(&self, number: usize) -> Result<Arc<dyn Instance>, String> {
        let (platform, native) = match (number, self.device) {
            (0, Device::Software(device) | Device::Hardware(device)) => {
                (number::PLATFORM_DEVICE, device)
            }
            (0, Device::Unnamed) | (1, Device::Software(_)) => {
                (number::PLATFORM_SURFACELESS, null_mut())
            }
            _ => return Err("EGL has no further display".into()),
        };
        // SAFETY: a platform with its kind of native display, and no attributes.
        let raw = unsafe { (self.platform_display)(platform, native, null()) };
        let (mut config, mut found) = (null_mut(), 0);
        // SAFETY: the display may be null, which EGL reports; the lists are terminated.
        let is_ready = unsafe {
            (self.api.initialize)(raw, null_mut(), null_mut()) != 0
                && (self.api.choose_config)(
                    raw,
                    number::CONFIG.as_ptr(),
                    &mut config,
                    1,
                    &mut found,
                ) != 0
                && found > 0
        };
        if is_ready {
            return Ok(Arc::new(Display { api: self.api, raw, config }));
        }
        // SAFETY: takes nothing.
        let code = unsafe { (self.api.get_error)() };
        Err(format!("EGL has no display that draws OpenGL off screen ({code:#06x})"))
    }
}

#[derive(Clone, Copy)]
struct Display {
    api: Api,
    raw: RawDisplay,
    config: *mut c_void,
}

// SAFETY: EGL's displays and configurations may be used by any thread; they are never freed.
unsafe impl Send for Display {}
// SAFETY: as above.
unsafe impl Sync for Display {}

impl Instance for Display {
    fn context(&self) -> Result<Box<dyn ThreadContext>, String> {
        let Self { api, raw, config } = *self;
        let size = [number::WIDTH, WINDOW_PX, number::HEIGHT, WINDOW_PX, number::NONE];
        // SAFETY: the configuration is the display's; the lists are terminated.
        let (surface, handle) = unsafe {
            (api.bind_api)(number::OPENGL_API);
            (
                (api.create_pbuffer)(raw, config, size.as_ptr()),
                (api.create_context)(raw, config, null_mut(), null()),
            )
        };
        let mut context = Box::new(EglContext { display: *self, handle, surface });
        if surface.is_null() || handle.is_null() || !context.make_current() {
            // SAFETY: takes nothing.
            return Err(format!("EGL error {:#06x}", unsafe { (api.get_error)() }));
        }
        Ok(context)
    }
}

struct EglContext {
    display: Display,
    handle: *mut c_void,
    surface: *mut c_void,
}

impl ThreadContext for EglContext {
    fn make_current(&mut self) -> bool {
        let Display { api, raw, .. } = self.display;
        // SAFETY: display, context and surface belong together, and are this thread's own.
        unsafe { (api.make_current)(raw, self.surface, self.surface, self.handle) != 0 }
    }
}

impl Drop for EglContext {
    fn drop(&mut self) {
        if is_left() {
            return;
        }
        let Display { api, raw, .. } = self.display;
        // SAFETY: display, context and surface belong together; EGL reports what is null.
        unsafe {
            (api.make_current)(raw, null_mut(), null_mut(), null_mut());
            (api.destroy_surface)(raw, self.surface);
            (api.destroy_context)(raw, self.handle);
        }
    }
}
