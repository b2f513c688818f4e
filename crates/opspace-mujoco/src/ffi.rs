//! Calls of the MuJoCo library, which is opened at run time.
//!
//! Only functions with opaque pointers are used, and no layout of a struct: these functions are the same from MuJoCo 3.2
//! on. The bits that select a part of the state are not, so that they are found by trial.

#![expect(unsafe_code, reason = "MuJoCo is a C library")]

use opspace_model::files::open_file;
use std::cell::Cell;
use std::error::Error;
use std::ffi::{CStr, CString, OsStr, c_char, c_int, c_uint, c_void};
use std::fmt;
use std::path::{Path, PathBuf};
use std::ptr::{NonNull, null};
use std::sync::{Arc, Mutex, PoisonError};

/// Oldest version whose functions are those used here.
const OLDEST: [u32; 2] = [3, 2];
/// Size of the text of an error, bytes.
const ERROR_BYTES: usize = 2048;
/// Memory for MuJoCo's virtual file system, in words. From version 3.2 on it is one pointer.
const FILE_SYSTEM_WORDS: usize = 512;
/// Kind of an object whose name is a joint's: `mjOBJ_JOINT`.
const JOINT: c_int = 3;
/// Bits of positions and velocities in a state.
const POSITIONS: c_uint = 1 << 1;
const VELOCITIES: c_uint = 1 << 2;
/// Bits among which that of the applied generalised forces is searched.
const APPLIED_BITS: std::ops::Range<u32> = 3..10;

type Pointer = *mut c_void;

/// Functions of the library.
struct Functions {
    version: unsafe extern "C" fn() -> *const c_char,
    default_files: unsafe extern "C" fn(Pointer),
    add_file: unsafe extern "C" fn(Pointer, *const c_char, *const c_void, c_int) -> c_int,
    delete_files: unsafe extern "C" fn(Pointer),
    load: unsafe extern "C" fn(*const c_char, *const c_void, *mut c_char, c_int) -> Pointer,
    delete_model: unsafe extern "C" fn(Pointer),
    make_data: unsafe extern "C" fn(Pointer) -> Pointer,
    delete_data: unsafe extern "C" fn(Pointer),
    step: unsafe extern "C" fn(Pointer, Pointer),
    forward: unsafe extern "C" fn(Pointer, Pointer),
    state_size: unsafe extern "C" fn(Pointer, c_uint) -> c_int,
    get_state: unsafe extern "C" fn(Pointer, Pointer, *mut f64, c_uint),
    set_state: unsafe extern "C" fn(Pointer, Pointer, *const f64, c_uint),
    index_of: unsafe extern "C" fn(Pointer, c_int, *const c_char) -> c_int,
    mass_times: unsafe extern "C" fn(Pointer, Pointer, *mut f64, *const f64),
    newton_euler: unsafe extern "C" fn(Pointer, Pointer, c_int, *mut f64),
    integrate: unsafe extern "C" fn(Pointer, *mut f64, *const f64, f64),
}

/// MuJoCo library in this process.
pub struct Library {
    functions: Functions,
    version: String,
    path: PathBuf,
    /// Bit of the applied generalised forces in a state.
    applied: c_uint,
    /// One file is read at a time.
    reading: Mutex<()>,
    /// Keeps the functions in memory.
    _library: libloading::Library,
}

impl fmt::Debug for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MuJoCo {} in {}", self.version, self.path.display())
    }
}

thread_local! {
    /// True if MuJoCo has warned in this thread: of a divergence, or of contacts for which it has no memory.
    static WARNED: Cell<bool> = const { Cell::new(false) };
}

/// Receives MuJoCo's warnings, which it would otherwise write into a file MUJOCO_LOG.TXT.
unsafe extern "C" fn note_warning(_: *const c_char) {
    WARNED.set(true);
}

/// Returns the system's reason why a library cannot be opened.
fn reason(error: &libloading::Error) -> String {
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

/// Returns a symbol of the library, whose type `T` the caller knows.
fn symbol<T: Copy>(library: &libloading::Library, name: &str) -> Result<T, String> {
    // SAFETY: the symbols and their types are those of mujoco.h, which is checked for each supported version.
    unsafe { library.get::<T>(name) }.map(|symbol| *symbol).map_err(|_| format!("it has no {name}"))
}

impl Functions {
    fn of(library: &libloading::Library) -> Result<Self, String> {
        Ok(Self {
            version: symbol(library, "mj_versionString")?,
            default_files: symbol(library, "mj_defaultVFS")?,
            add_file: symbol(library, "mj_addBufferVFS")?,
            delete_files: symbol(library, "mj_deleteVFS")?,
            load: symbol(library, "mj_loadXML")?,
            delete_model: symbol(library, "mj_deleteModel")?,
            make_data: symbol(library, "mj_makeData")?,
            delete_data: symbol(library, "mj_deleteData")?,
            step: symbol(library, "mj_step")?,
            forward: symbol(library, "mj_forward")?,
            state_size: symbol(library, "mj_stateSize")?,
            get_state: symbol(library, "mj_getState")?,
            set_state: symbol(library, "mj_setState")?,
            index_of: symbol(library, "mj_name2id")?,
            mass_times: symbol(library, "mj_mulM")?,
            newton_euler: symbol(library, "mj_rne")?,
            integrate: symbol(library, "mj_integratePos")?,
        })
    }
}

impl Library {
    /// Opens the library in this file. The error describes what is wrong with it.
    pub fn open(path: &Path) -> Result<Arc<Self>, String> {
        // A name alone would be looked for in the folders of the system's loader, one of which may be the working folder.
        let path = open_file(path).and_then(|_| path.canonicalize()).map_err(|error| error.to_string())?;
        // SAFETY: opening MuJoCo only initialises its constants and its list of plugins.
        let library = unsafe { libloading::Library::new(&path) }.map_err(|error| reason(&error))?;
        let functions = Functions::of(&library)?;
        // SAFETY: the function returns a constant text.
        let version = unsafe { CStr::from_ptr((functions.version)()) }.to_string_lossy().into_owned();
        let mut numbers = version.split('.').map(|number| number.parse().unwrap_or(0));
        if [numbers.next().unwrap_or(0), numbers.next().unwrap_or(0)] < OLDEST {
            return Err(format!("it is version {version}, and 3.2 is the oldest that works"));
        }
        let handler: *mut Option<unsafe extern "C" fn(*const c_char)> = symbol(&library, "mju_user_warning")?;
        // SAFETY: the symbol is a variable with a pointer to a function, which is set once and always to the same value.
        unsafe { handler.write(Some(note_warning)) };
        let reading = Mutex::new(());
        let mut opened = Self { functions, version, path, applied: 0, reading, _library: library };
        opened.applied = find_applied(&opened)?;
        Ok(Arc::new(opened))
    }

    /// Version, for example `3.2.7`.
    pub fn version(&self) -> &str {
        &self.version
    }

    /// Compiles a model, and returns it with MuJoCo's text if it cannot. `path` is the file from which relative paths of
    /// other files start; with `text`, it is not read itself.
    fn compile(&self, path: &Path, text: Option<&str>) -> Result<Pointers, String> {
        let _one = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let name = path.to_str().and_then(|path| CString::new(path).ok());
        let name = name.ok_or("its path is not a text that MuJoCo can read")?;
        let mut files = [0_u64; FILE_SYSTEM_WORDS];
        let mut error = [0; ERROR_BYTES];
        let files_pointer: Pointer = files.as_mut_ptr().cast();
        let model = match text {
            // SAFETY: the name ends with a zero, and the error has the size that is stated.
            None => unsafe {
                (self.functions.load)(name.as_ptr(), null(), error.as_mut_ptr(), ERROR_BYTES as c_int)
            },
            Some(text) => {
                let length = c_int::try_from(text.len()).map_err(|_| "the file is too long")?;
                // SAFETY: the file system is larger than MuJoCo's, lives until it is deleted, and copies the text.
                unsafe {
                    (self.functions.default_files)(files_pointer);
                    (self.functions.add_file)(files_pointer, name.as_ptr(), text.as_ptr().cast(), length);
                    let load = self.functions.load;
                    let model = load(name.as_ptr(), files_pointer, error.as_mut_ptr(), ERROR_BYTES as c_int);
                    (self.functions.delete_files)(files_pointer);
                    model
                }
            }
        };
        let Some(model) = NonNull::new(model) else { return Err(words(&error)) };
        // SAFETY: the model is complete.
        let data = NonNull::new(unsafe { (self.functions.make_data)(model.as_ptr()) });
        match data {
            Some(data) => Ok(Pointers { model, data }),
            None => {
                // SAFETY: the model was made above, and nobody else has it.
                unsafe { (self.functions.delete_model)(model.as_ptr()) };
                Err("there is not enough memory".to_owned())
            }
        }
    }

    /// Compiles a file.
    pub fn load_file(self: &Arc<Self>, path: &Path) -> Result<Instance, String> {
        Ok(Instance::new(self.compile(path, None)?, self))
    }

    /// Compiles a text, in which relative paths start from the folder of `path`.
    pub fn load_text(self: &Arc<Self>, path: &Path, text: &str) -> Result<Instance, String> {
        Ok(Instance::new(self.compile(path, Some(text))?, self))
    }

    fn state_size(&self, pointers: &Pointers, bits: c_uint) -> usize {
        // SAFETY: the model is complete, and the bits are those of all supported versions.
        let size = unsafe { (self.functions.state_size)(pointers.model.as_ptr(), bits) };
        usize::try_from(size).unwrap_or(0)
    }

    fn set(&self, pointers: &Pointers, bits: c_uint, values: &[f64]) {
        assert_eq!(values.len(), self.state_size(pointers, bits), "one value per element");
        // SAFETY: model and data belong together, and the length was checked.
        unsafe {
            (self.functions.set_state)(
                pointers.model.as_ptr(),
                pointers.data.as_ptr(),
                values.as_ptr(),
                bits,
            );
        }
    }

    fn get(&self, pointers: &Pointers, bits: c_uint, values: &mut [f64]) {
        assert_eq!(values.len(), self.state_size(pointers, bits), "one value per element");
        // SAFETY: as in `set`.
        unsafe {
            let Pointers { model, data } = pointers;
            (self.functions.get_state)(model.as_ptr(), data.as_ptr(), values.as_mut_ptr(), bits);
        }
    }

    fn step(&self, pointers: &Pointers) {
        // SAFETY: model and data belong together.
        unsafe { (self.functions.step)(pointers.model.as_ptr(), pointers.data.as_ptr()) };
    }

    fn delete(&self, pointers: &Pointers) {
        // SAFETY: nobody uses the pointers afterwards.
        unsafe {
            (self.functions.delete_data)(pointers.data.as_ptr());
            (self.functions.delete_model)(pointers.model.as_ptr());
        }
    }
}

/// Returns MuJoCo's text of an error in one line.
fn words(error: &[c_char]) -> String {
    let bytes: Vec<u8> = error.iter().map(|&c| c as u8).take_while(|&byte| byte != 0).collect();
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    lines.join("; ").replace(":;", ":")
}

/// Model of three sliding masses of 2 kg without gravity, in steps of 0.5 s.
const PROBE: &str = r#"<mujoco><option timestep="0.5" gravity="0 0 0" integrator="Euler"/><worldbody><body>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
</body></worldbody></mujoco>"#;

/// Finds the bit of the applied generalised forces: by F = m a. Checks the bits of positions and velocities as well.
fn find_applied(library: &Library) -> Result<c_uint, String> {
    let probe = library.compile(Path::new("opspace-probe.xml"), Some(PROBE))?;
    let set_and_step = |bit, values: [f64; 3], result| {
        let mut after = [0.0; 3];
        if library.state_size(&probe, bit) == 3 {
            library.set(&probe, VELOCITIES, &[0.0; 3]);
            library.set(&probe, POSITIONS, &[0.0; 3]);
            library.set(&probe, bit, &values);
            library.step(&probe);
            library.get(&probe, result, &mut after);
            library.set(&probe, bit, &[0.0; 3]);
        }
        after
    };
    let moves = set_and_step(VELOCITIES, [1.0, 2.0, 3.0], POSITIONS) == [0.5, 1.0, 1.5];
    let is_force = |&bit: &c_uint| set_and_step(bit, [4.0, 8.0, 12.0], VELOCITIES) == [1.0, 2.0, 3.0];
    let found = APPLIED_BITS.map(|bit| 1 << bit).find(is_force).filter(|_| moves);
    library.delete(&probe);
    found.ok_or_else(|| format!("version {} has another layout of its state", library.version))
}

struct Pointers {
    model: NonNull<c_void>,
    data: NonNull<c_void>,
}

// SAFETY: model and data are of one instance, which alone has the pointers; MuJoCo keeps no state of threads in them.
unsafe impl Send for Pointers {}

/// Compiled model with one state.
pub struct Instance {
    library: Arc<Library>,
    pointers: Pointers,
    nq: usize,
    nv: usize,
}

impl Drop for Instance {
    fn drop(&mut self) {
        self.library.delete(&self.pointers);
    }
}

impl Instance {
    fn new(pointers: Pointers, library: &Arc<Library>) -> Self {
        let (nq, nv) = (library.state_size(&pointers, POSITIONS), library.state_size(&pointers, VELOCITIES));
        Self { library: Arc::clone(library), pointers, nq, nv }
    }

    /// Number of positions.
    pub fn nq(&self) -> usize {
        self.nq
    }

    /// Number of velocities.
    pub fn nv(&self) -> usize {
        self.nv
    }

    /// Index of the joint with this name.
    pub fn joint(&self, name: &str) -> Option<usize> {
        let name = CString::new(name).ok()?;
        // SAFETY: the model is complete, and the name ends with a zero.
        let index =
            unsafe { (self.library.functions.index_of)(self.pointers.model.as_ptr(), JOINT, name.as_ptr()) };
        usize::try_from(index).ok()
    }

    /// Copies the positions.
    pub fn positions(&self, q: &mut [f64]) {
        self.library.get(&self.pointers, POSITIONS, q);
    }

    /// Copies the velocities.
    pub fn velocities(&self, v: &mut [f64]) {
        self.library.get(&self.pointers, VELOCITIES, v);
    }

    /// Sets positions, velocities and applied generalised forces.
    pub fn set(&mut self, q: &[f64], v: &[f64], forces: &[f64]) {
        self.library.set(&self.pointers, POSITIONS, q);
        self.library.set(&self.pointers, VELOCITIES, v);
        self.library.set(&self.pointers, self.library.applied, forces);
    }

    /// Advances by the time step of the model. Returns false if MuJoCo warns: the state is then of no use.
    pub fn step(&mut self) -> bool {
        WARNED.set(false);
        self.library.step(&self.pointers);
        !WARNED.get()
    }

    /// Computes everything that depends on the state.
    pub fn forward(&mut self) {
        // SAFETY: model and data belong together.
        unsafe {
            let Pointers { model, data } = &self.pointers;
            (self.library.functions.forward)(model.as_ptr(), data.as_ptr());
        }
    }

    /// Computes the product of the mass matrix, which the last step or [`forward`](Self::forward) computed, and `v`.
    pub fn mass_times(&self, v: &[f64], product: &mut [f64]) {
        assert!(v.len() == self.nv && product.len() == self.nv, "one value per degree of freedom");
        // SAFETY: model and data belong together, and the lengths were checked.
        unsafe {
            let (times, Pointers { model, data }) = (self.library.functions.mass_times, &self.pointers);
            times(model.as_ptr(), data.as_ptr(), product.as_mut_ptr(), v.as_ptr());
        }
    }

    /// Computes the forces of gravity and velocity in the state of the last [`forward`](Self::forward).
    pub fn bias(&mut self, bias: &mut [f64]) {
        assert_eq!(bias.len(), self.nv, "one value per degree of freedom");
        // SAFETY: model and data belong together, and the length was checked. 0: without accelerations.
        unsafe {
            let Pointers { model, data } = &self.pointers;
            (self.library.functions.newton_euler)(model.as_ptr(), data.as_ptr(), 0, bias.as_mut_ptr());
        }
    }

    /// Moves `q` by the velocities `v` for `dt_s` (s), including unit quaternions.
    pub fn integrate(&self, q: &mut [f64], v: &[f64], dt_s: f64) {
        assert!(q.len() == self.nq && v.len() == self.nv, "one value per coordinate");
        // SAFETY: the model is complete, and the lengths were checked.
        unsafe {
            let model = self.pointers.model.as_ptr();
            (self.library.functions.integrate)(model, q.as_mut_ptr(), v.as_ptr(), dt_s);
        }
    }
}

/// Returns true if the name of a file is that of the library, on any system.
pub fn is_library_name(name: &OsStr) -> bool {
    name.to_str().is_some_and(|name| {
        let unix = name.starts_with("libmujoco.") && (name.contains(".so") || name.ends_with(".dylib"));
        unix || name == "mujoco.dll"
    })
}
