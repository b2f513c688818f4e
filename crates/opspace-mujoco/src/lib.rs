//! MuJoCo as the physics engine of a simulation.
//!
//! The library is found at run time: `pip install mujoco` is enough, and nothing is needed to build. Versions from 3.2 on
//! work. MuJoCo has rigid bodies, gravity, and contacts with the objects of a scene; drives, gears, friction, end stops,
//! brakes, sensors and bus are opspace's, as are the objects of a task's environment.
//!
//! ```no_run
//! use opspace_mujoco::Mujoco;
//! use opspace_sim::{PhysicsEngine, SimulatedArm, Simulation, SimulationConfig};
//! # fn example(config: SimulationConfig) -> Result<(), Box<dyn std::error::Error>> {
//!
//! let mujoco = Mujoco::find(None)?;
//! let arms: Vec<SimulatedArm> = Simulation::with_plant(config, |parts| mujoco.build(parts))?.into_arms();
//! # Ok(())
//! # }
//! ```

mod error;
mod ffi;
mod locate;
mod mjcf;
mod plant;

pub use error::MujocoError;
pub use locate::{VARIABLE, find_library};

use crate::ffi::{Instance, Library};
use crate::mjcf::ModelSettings;
use crate::plant::MujocoPlant;
use nalgebra::{DMatrix, DVector};
use opspace_model::files::read_file;
use opspace_sim::{PhysicsEngine, Plant, PlantArm, PlantConfig, PlantError, Scene};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest size of the file of a scene, bytes: its meshes are files of their own.
const MAX_SCENE_BYTES: u64 = 16 << 20;

/// Largest number of files that a scene includes, those of included files among them.
const MAX_INCLUDED: usize = 100;

/// Reads the file of a scene, or one that it includes.
fn read_scene(path: &Path) -> Result<String, MujocoError> {
    read_file(path, MAX_SCENE_BYTES)
        .and_then(|bytes| String::from_utf8(bytes).map_err(io::Error::other))
        .map_err(|source| MujocoError::Scene { path: path.to_owned(), source })
}

/// Checks that the files which a scene includes can be read, also those that they include: MuJoCo opens them itself, and would wait
/// for the writer of a pipe. Their paths are relative to the folder of the scene. What MuJoCo refuses with its own words is not
/// checked: files that are missing, and text that is not XML. Meshes, height fields and textures are not checked either.
fn check_included(scene: &Path, text: &str) -> Result<(), MujocoError> {
    let mut seen: Vec<PathBuf> = Vec::new();
    let mut open = mjcf::included(text);
    while let Some(file) = open.pop() {
        let path = scene.with_file_name(file);
        // MuJoCo refuses a file that is included twice.
        if seen.contains(&path) || !path.exists() {
            continue;
        }
        if seen.len() == MAX_INCLUDED {
            let source = io::Error::other(format!("it includes more than {MAX_INCLUDED} files"));
            return Err(MujocoError::Scene { path: scene.to_owned(), source });
        }
        open.extend(mjcf::included(&read_scene(&path)?));
        seen.push(path);
    }
    Ok(())
}

/// MuJoCo, with or without a scene.
#[derive(Clone, Debug)]
pub struct Mujoco {
    library: Arc<Library>,
    scene: Option<Scene>,
}

impl Mujoco {
    /// Opens the library that [`find_library`] finds. `scene` is a file in MuJoCo's format with objects that are
    /// simulated with the arms.
    ///
    /// # Errors
    /// No library, a version that is too old, or a scene that cannot be read, or that includes a file that cannot be read.
    /// Other faults of a scene are found when a plant is built.
    pub fn find(scene: Option<&Path>) -> Result<Self, MujocoError> {
        Self::open(&find_library()?, scene)
    }

    /// Opens the library in a file, as [`find`](Self::find) does.
    ///
    /// # Errors
    /// As [`find`](Self::find).
    pub fn open(library: &Path, scene: Option<&Path>) -> Result<Self, MujocoError> {
        let error = |reason| MujocoError::Library { path: library.to_owned(), reason };
        let read = |path: &Path| {
            let text = read_scene(path)?;
            check_included(path, &text)?;
            Ok(Scene { path: path.to_owned(), text })
        };
        let scene = scene.map(read).transpose()?;
        Ok(Self { library: Library::open(library).map_err(error)?, scene })
    }

    /// Moves an arm from rest at its start under constant joint torques (n; Nm, N) by steps of `step_s` (s) of MuJoCo's own
    /// Runge–Kutta method of fourth order, and returns its positions (n; rad, m), to compare integrators.
    ///
    /// # Errors
    /// An arm that MuJoCo refuses.
    pub fn runge_kutta(
        &self,
        arm: &PlantArm,
        torques: &[f64],
        step_s: f64,
        steps: u32,
    ) -> Result<Vec<f64>, PlantError> {
        let mut instance = self.instance(arm, step_s, "RK4")?;
        let mut q = arm.q.clone();
        instance.set(&q, &vec![0.0; q.len()], torques);
        (0..steps).for_each(|_| {
            instance.step();
        });
        instance.positions(&mut q);
        Ok(q)
    }

    /// Compiles a model of one arm.
    fn instance(
        &self,
        arm: &PlantArm,
        step_s: f64,
        integrator: &'static str,
    ) -> Result<Instance, PlantError> {
        let error = |message| PlantError { message, file: None };
        let settings = ModelSettings { step_s, integrator, has_contacts: false, load_cell: None };
        let text = mjcf::write(std::slice::from_ref(arm), None, &settings).map_err(error)?;
        self.library.load_text(Path::new("arm.xml"), &text).map_err(error)
    }

    /// Computes mass matrix (n × n) and bias torques (n; Nm, N), of gravity and velocity, of an arm in the state `q`
    /// (n; rad, m) and `dq` (n; rad/s, m/s), to compare models.
    ///
    /// # Errors
    /// An arm that MuJoCo refuses.
    pub fn dynamics(
        &self,
        arm: &PlantArm,
        q: &[f64],
        dq: &[f64],
    ) -> Result<(DMatrix<f64>, DVector<f64>), PlantError> {
        let mut instance = self.instance(arm, 1e-3, "Euler")?;
        let n = arm.model.n();
        instance.set(q, dq, &vec![0.0; n]);
        instance.forward();
        let (mut mass, mut bias, mut unit) = (DMatrix::zeros(n, n), DVector::zeros(n), DVector::zeros(n));
        for (column, mut product) in mass.column_iter_mut().enumerate() {
            unit.fill(0.0);
            unit[column] = 1.0;
            instance.mass_times(unit.as_slice(), product.as_mut_slice());
        }
        instance.bias(bias.as_mut_slice());
        Ok((mass, bias))
    }
}

impl PhysicsEngine for Mujoco {
    fn name(&self) -> &str {
        "mujoco"
    }

    fn version(&self) -> &str {
        self.library.version()
    }

    fn scene(&self) -> Option<&Scene> {
        self.scene.as_ref()
    }

    fn build(&self, parts: PlantConfig) -> Result<Box<dyn Plant>, PlantError> {
        Ok(Box::new(MujocoPlant::new(&self.library, parts, self.scene.as_ref())?))
    }
}
