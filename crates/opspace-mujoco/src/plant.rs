//! Arms, and objects of a scene, in MuJoCo.
//!
//! MuJoCo computes the accelerations under the joint torques of the drives and of opspace's environment, in the middle of
//! each step; the step itself is that of opspace's own plant. One step of MuJoCo's semi-implicit Euler method changes
//! the velocity by the time step times the acceleration, which gives the acceleration without access to MuJoCo's structs.

use crate::ffi::{Instance, Library};
use crate::mjcf::{LOAD_CELL, ModelSettings, contents, joint_name, write};
use nalgebra::Vector3;
use opspace_model::Force;
use opspace_sim::{JointTorque, Plant, PlantArm, PlantArms, PlantConfig, PlantError, PlantFrame, Scene};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// State of a model with all its forces.
struct State {
    q: Vec<f64>,
    v: Vec<f64>,
    forces: Vec<f64>,
}

impl State {
    fn of(instance: &Instance) -> Self {
        let mut state = Self {
            q: vec![0.0; instance.nq()],
            v: vec![0.0; instance.nv()],
            forces: vec![0.0; instance.nv()],
        };
        instance.positions(&mut state.q);
        state
    }
}

/// Plant whose accelerations MuJoCo computes.
pub struct MujocoPlant {
    arms: PlantArms,
    instance: Instance,
    step_s: f64,
    /// Number of joints of all arms, which are the first coordinates.
    joints: usize,
    /// Positions of all coordinates, those of the arms without meaning.
    q: Vec<f64>,
    /// Velocities of all coordinates, those of the arms without meaning.
    v: Vec<f64>,
    /// Accelerations in the middle of the last step.
    accelerations: Vec<f64>,
    /// Accelerations in the middle of the present step.
    trial: Vec<f64>,
    middle: State,
    load_cells: Vec<LoadCell>,
}

impl MujocoPlant {
    /// Returns the plant at rest at its start.
    ///
    /// # Errors
    /// An arm or a scene that MuJoCo refuses.
    pub fn new(
        library: &Arc<Library>,
        config: PlantConfig,
        scene: Option<&Scene>,
    ) -> Result<Self, PlantError> {
        let load = |settings: &ModelSettings| compile(library, &config.arms, scene, settings);
        let settings = |has_contacts, load_cell| ModelSettings {
            step_s: config.step_s,
            integrator: "Euler",
            has_contacts,
            load_cell,
        };
        let instance = load(&settings(scene.is_some(), None))?;
        let joints = check_joints(&instance, &config.arms)?;
        let mut load_cells = Vec::new();
        if scene.is_some() {
            for (arm, parts) in config.arms.iter().enumerate() {
                for &frame in &parts.sensors {
                    let frame = PlantFrame { arm, frame };
                    // A force sensor on the base feels no contact of a moving body.
                    if parts.model.frame(frame.frame).body.is_some() {
                        let [with, without] =
                            [true, false].map(|contacts| load(&settings(contacts, Some(frame))));
                        load_cells.push(LoadCell::new(frame, [with?, without?], &config)?);
                    }
                }
            }
        }
        let mut middle = State::of(&instance);
        let q = middle.q.clone();
        let step_s = config.step_s;
        let arms = PlantArms::new(config);
        middle.q[..joints].copy_from_slice(arms.q());
        let zeros = vec![0.0; instance.nv()];
        Ok(Self {
            v: zeros.clone(),
            accelerations: zeros.clone(),
            trial: zeros,
            q,
            middle,
            arms,
            instance,
            step_s,
            joints,
            load_cells,
        })
    }

    /// Computes the accelerations in the middle of a step under these torques, with those of the scene in the step before.
    fn accelerate(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]) {
        self.arms.begin_step(time_s, dt_s, torques);
        self.predict_scene(dt_s);
        let (n, State { q, v, forces }) = (self.joints, &mut self.middle);
        self.arms.copy_middle(&mut q[..n], &mut v[..n], &mut forces[..n]);
        acceleration(&mut self.instance, &self.middle, self.step_s, &mut self.trial);
    }

    /// Predicts positions and velocities of the scene in the middle of a step of `dt_s`.
    fn predict_scene(&mut self, dt_s: f64) {
        if self.v.len() == self.joints {
            return;
        }
        self.middle.q.copy_from_slice(&self.q);
        self.instance.integrate(&mut self.middle.q, &self.v, 0.5 * dt_s);
        for i in self.joints..self.v.len() {
            self.middle.v[i] = self.v[i] + 0.5 * dt_s * self.accelerations[i];
        }
    }

    /// Advances the scene by a step of `dt_s` with the accelerations in its middle.
    fn advance_scene(&mut self, dt_s: f64) {
        if self.v.len() == self.joints {
            return;
        }
        for (v, a) in self.v.iter_mut().zip(&self.accelerations) {
            *v += 0.5 * dt_s * a;
        }
        self.instance.integrate(&mut self.q, &self.v, dt_s);
        for (v, a) in self.v.iter_mut().zip(&self.accelerations) {
            *v += 0.5 * dt_s * a;
        }
    }
}

impl Plant for MujocoPlant {
    fn arms(&self) -> &PlantArms {
        &self.arms
    }

    fn arms_mut(&mut self) -> &mut PlantArms {
        &mut self.arms
    }

    fn step(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]) {
        self.accelerate(time_s, dt_s, torques);
        self.accelerations.copy_from_slice(&self.trial);
        self.arms.end_step(dt_s, &mut self.accelerations[..self.joints]);
        self.advance_scene(dt_s);
    }

    fn end_velocities(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque], dq: &mut [f64]) -> bool {
        self.accelerate(time_s, dt_s, torques);
        self.arms.end_velocities(dt_s, &mut self.trial[..self.joints], dq);
        true
    }

    fn contact_wrench(&mut self, frame: PlantFrame) -> Force {
        let own = self.arms.contact_wrench(frame);
        match self.load_cells.iter_mut().find(|cell| cell.frame == frame) {
            Some(cell) => own + cell.measure(&self.middle, self.joints, self.step_s),
            None => own,
        }
    }
}

/// Computes the acceleration in a state, from a step of `step_s`; not a number if the state has none, or if MuJoCo warns, so
/// that the run ends.
fn acceleration(instance: &mut Instance, state: &State, step_s: f64, result: &mut [f64]) {
    if !state.q.iter().chain(&state.v).chain(&state.forces).all(|value| value.is_finite()) {
        result.fill(f64::NAN);
        return;
    }
    instance.set(&state.q, &state.v, &state.forces);
    if !instance.step() {
        result.fill(f64::NAN);
        return;
    }
    instance.velocities(result);
    for (after, before) in result.iter_mut().zip(&state.v) {
        *after = (*after - before) / step_s;
    }
}

/// Force sensor for MuJoCo's own contacts. Six joints between a body and the joint that moves it, which a large inertia
/// keeps at rest, bear the wrench of all contacts of the body, and of bodies that it moves. It is the product of the
/// mass matrix and the difference of the accelerations with and without contacts. The model with these joints is not
/// the one that moves the arms.
struct LoadCell {
    frame: PlantFrame,
    /// Models with and without contacts.
    instances: [Instance; 2],
    state: State,
    accelerations: [Vec<f64>; 2],
    forces: Vec<f64>,
    /// Indices of the arms' joints.
    joints: Vec<usize>,
    /// Index of the first joint of the load cell.
    first: usize,
}

impl LoadCell {
    fn new(frame: PlantFrame, instances: [Instance; 2], config: &PlantConfig) -> Result<Self, PlantError> {
        let find = |name: &str| {
            instances[0].joint(name).ok_or_else(|| PlantError {
                message: format!("MuJoCo's model has no joint '{name}'"),
                file: None,
            })
        };
        let joints = names(&config.arms).map(|name| find(&name)).collect::<Result<Vec<_>, _>>()?;
        let (first, nv) = (find(LOAD_CELL[0])?, instances[0].nv());
        let zeros = vec![0.0; nv];
        Ok(Self {
            frame,
            state: State::of(&instances[0]),
            instances,
            accelerations: [zeros.clone(), zeros.clone()],
            forces: zeros,
            joints,
            first,
        })
    }

    /// Returns the wrench (N, Nm) on the body in the axes of the frame, in a state of the arms with `n` joints and the
    /// scene.
    fn measure(&mut self, state: &State, n: usize, step_s: f64) -> Force {
        let scene = n + LOAD_CELL.len();
        let own = &mut self.state;
        for (to, &joint) in self.joints.iter().enumerate() {
            (own.q[joint], own.v[joint], own.forces[joint]) = (state.q[to], state.v[to], state.forces[to]);
        }
        own.q[scene..].copy_from_slice(&state.q[n..]);
        own.v[scene..].copy_from_slice(&state.v[n..]);
        let [with, without] = &mut self.accelerations;
        acceleration(&mut self.instances[0], own, step_s, with);
        acceleration(&mut self.instances[1], own, step_s, without);
        with.iter_mut().zip(without).for_each(|(with, without)| *with -= *without);
        self.instances[1].mass_times(&self.accelerations[0], &mut self.forces);
        let part = |at: usize| Vector3::from_column_slice(&self.forces[at..at + 3]);
        Force { linear: part(self.first), angular: part(self.first + 3) }
    }
}

/// Names of the joints of all arms in MuJoCo.
fn names(arms: &[PlantArm]) -> impl Iterator<Item = String> {
    let joints = |(index, arm): (usize, &PlantArm)| {
        let name = move |joint: &opspace_model::Joint| joint_name(index, &joint.name);
        arm.model.joints().iter().map(name).collect::<Vec<_>>()
    };
    arms.iter().enumerate().flat_map(joints).collect::<Vec<_>>().into_iter()
}

/// Checks that the joints of the arms are MuJoCo's first ones, and returns their number.
fn check_joints(instance: &Instance, arms: &[PlantArm]) -> Result<usize, PlantError> {
    let names: Vec<String> = names(arms).collect();
    match names.iter().enumerate().find(|(index, name)| instance.joint(name) != Some(*index)) {
        None => Ok(names.len()),
        Some((_, name)) => Err(PlantError {
            message: format!("MuJoCo has joint '{name}' in another place than expected"),
            file: None,
        }),
    }
}

/// Compiles arms and scene.
fn compile(
    library: &Arc<Library>,
    arms: &[PlantArm],
    scene: Option<&Scene>,
    settings: &ModelSettings,
) -> Result<Instance, PlantError> {
    let of_robot = |message| PlantError { message, file: None };
    let Some(scene) = scene else {
        let text = write(arms, None, settings).map_err(of_robot)?;
        return library
            .load_text(Path::new("arms.xml"), &text)
            .map_err(|words| of_robot(format!("MuJoCo refuses the robot: {words}")));
    };
    let of_scene = |message: String| PlantError { message, file: Some(scene.path.clone()) };
    // Without a readable element, MuJoCo itself says why.
    let inner = contents(&scene.text);
    let text = write(arms, Some(inner.unwrap_or_default()), settings).map_err(of_robot)?;
    let joined = match inner {
        Some(_) => library.load_text(&beside(&scene.path), &text),
        None => Err("the file has no <mujoco> element".to_owned()),
    };
    joined.map_err(|words| match library.load_file(&scene.path) {
        // Lines of the user's file, if it is wrong by itself.
        Err(words) => of_scene(format!("MuJoCo refuses the scene: {words}")),
        Ok(_) => of_scene(format!("MuJoCo refuses the scene with the arm in it: {words}")),
    })
}

/// Path of a file that does not exist, in the folder of the scene.
fn beside(scene: &Path) -> PathBuf {
    scene.with_file_name("opspace-joined-scene.xml")
}
