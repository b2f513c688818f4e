//! Class `Model`: kinematics and dynamics of a robot.

use crate::arrays::{check_out, copied2, owned1, owned2, owned3, rows, vector};
use crate::errors::{argument, caught, of_file, refused};
use crate::mujoco;
use nalgebra::{Matrix6, Matrix6xX, SymmetricEigen};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods};
use opspace_control::orientation::quaternion;
use opspace_experiment::files::robot::load_urdf;
use opspace_experiment::{Files, RobotDefinition, Source};
use opspace_model::{
    Data, FrameId, Inversion, Motion, OperationalSpace, Placement, UrdfOptions, frame_bias_acceleration,
    frame_jacobian, frame_placement, frame_velocity, update,
};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Least ratio of the eigenvalues of Λ⁻¹ of rows that are independent: below it, Λ has no correct digits.
const SINGULAR: f64 = 1e-13;

/// Kinematics and dynamics of a robot with n joints.
///
/// Units are SI: rad and Nm, or m and N for prismatic joints. Vectors are in world axes, linear rows come before angular
/// rows, and quaternions are w, x, y, z. Matrices are copies: later calls do not change them. Any thread may use a model; two
/// threads that update it need a model each.
#[pyclass(frozen, module = "opspace")]
pub(crate) struct Model {
    model: Arc<opspace_model::Model>,
    friction: Vec<f64>,
    damping: Vec<f64>,
    state: Mutex<State>,
}

/// Position and quaternion.
type Pose<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>);

/// State of a model, and all that is computed from it.
struct State {
    data: Data,
    q: Vec<f64>,
    dq: Vec<f64>,
    jacobian: Matrix6xX<f64>,
    space: OperationalSpace,
    is_updated: bool,
}

impl State {
    fn new(model: &opspace_model::Model) -> Self {
        let n = model.n();
        Self {
            data: Data::new(model),
            q: vec![0.0; n],
            dq: vec![0.0; n],
            jacobian: Matrix6xX::zeros(n),
            space: OperationalSpace::new(n),
            is_updated: false,
        }
    }
}

impl Model {
    /// Creates the object of a model; `friction` and `damping` have one value per joint, or are empty for zeros.
    pub(crate) fn new(model: Arc<opspace_model::Model>, friction: Vec<f64>, damping: Vec<f64>) -> Self {
        let state = Mutex::new(State::new(&model));
        let or_zeros = |values: Vec<f64>| if values.is_empty() { vec![0.0; model.n()] } else { values };
        let (friction, damping) = (or_zeros(friction), or_zeros(damping));
        Self { model, friction, damping, state }
    }

    /// Creates the object of the model of a robot file.
    pub(crate) fn of_robot(robot: &RobotDefinition) -> Self {
        let joints = robot.joints();
        let friction = joints.iter().map(|joint| joint.friction.coulomb_nm.get()).collect();
        let damping = joints.iter().map(|joint| joint.friction.viscous_nms_per_rad.get()).collect();
        Self::new(Arc::new(robot.model.clone()), friction, damping)
    }

    /// Takes the state of a control cycle.
    pub(crate) fn follow(&self, data: &Data) {
        let mut state = self.lock();
        state.data.clone_from(data);
        state.q.copy_from_slice(data.q.as_slice());
        state.dq.copy_from_slice(data.dq.as_slice());
        state.is_updated = true;
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the state after an update.
    fn updated(&self) -> PyResult<MutexGuard<'_, State>> {
        let state = self.lock();
        if state.is_updated {
            return Ok(state);
        }
        Err(refused("the model has no state yet", Some("call update(q, dq) first")))
    }

    fn frame(&self, name: &str) -> PyResult<FrameId> {
        self.model.frame_id(name).map_err(|unknown| argument("frame", &unknown.to_string()))
    }

    fn of_joints<T>(&self, of: impl Fn(&opspace_model::Joint) -> T) -> Vec<T> {
        self.model.joints().iter().map(of).collect()
    }
}

#[pymethods]
impl Model {
    /// Reads a URDF: its text, or the path of the file.
    ///
    /// The root link is fixed to the world. The armature is zero: a URDF does not state it.
    ///
    /// Raises OpspaceError for a mistake in the file, with its line.
    #[staticmethod]
    fn from_urdf(py: Python<'_>, urdf: &Bound<'_, PyAny>) -> PyResult<Self> {
        let text = urdf.extract::<String>().ok().filter(|text| text.trim_start().starts_with('<'));
        let source = match text {
            Some(text) => Source::new("urdf", text),
            None => {
                let path: PathBuf =
                    urdf.extract().map_err(|_| argument("urdf", "expected a text or the path of a file"))?;
                Source::read(path).map_err(|error| of_file(&error, &[]))?
            }
        };
        let parsed = py.detach(|| caught(|| load_urdf(&source, UrdfOptions::default())))?;
        let parsed = parsed.map_err(|error| of_file(&error, &[]))?;
        let of = |value: fn(&opspace_model::JointDynamics) -> Option<f64>| {
            parsed.dynamics.iter().map(|dynamics| value(dynamics).unwrap_or(0.0)).collect()
        };
        let (friction, damping) = (of(|dynamics| dynamics.friction), of(|dynamics| dynamics.damping));
        Ok(Self::new(Arc::new(parsed.model), friction, damping))
    }

    /// Reads a robot: its folder, or the path of its robot.toml. Armature, mount, payload and frames are those of the file.
    ///
    /// Raises OpspaceError for a mistake in the files, with its place.
    #[staticmethod]
    fn from_robot(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let robot = py.detach(|| caught(|| RobotDefinition::load(Files::Disk, &folder, &[])))?;
        Ok(Self::of_robot(&robot.map_err(|error| of_file(&error, &[]))?))
    }

    /// Reads a compiled model of MuJoCo (`mujoco.MjModel`): bodies, inertias, hinge and slide joints, armature, friction loss,
    /// limits, equalities of joints, and gravity.
    ///
    /// `joints` names the joints of the robot, and all others are locked at `qpos0`; None takes all. Frames are the bodies and
    /// the sites, by their names. q is MuJoCo's `qpos` of these joints.
    ///
    /// Raises OpspaceError for free and ball joints among them, and for equalities other than a line through two joints.
    #[staticmethod]
    #[pyo3(signature = (model, joints=None))]
    fn from_mujoco(model: &Bound<'_, PyAny>, joints: Option<Vec<String>>) -> PyResult<Self> {
        caught(|| mujoco::read(model, joints.as_deref()))?
    }

    /// Name of the robot.
    #[getter]
    fn name(&self) -> &str {
        self.model.name()
    }

    /// Number of joints, n.
    #[getter]
    fn n(&self) -> usize {
        self.model.n()
    }

    /// Names of the joints, in the order of q (n).
    #[getter]
    fn joints(&self) -> Vec<&str> {
        self.model.joints().iter().map(|joint| joint.name.as_str()).collect()
    }

    /// Names of the frames.
    #[getter]
    fn frames(&self) -> Vec<&str> {
        self.model.frames().iter().map(|frame| frame.name.as_str()).collect()
    }

    /// Limits of the positions (n, 2), rad or m: lower and upper; infinite for none.
    #[getter]
    fn position_limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let limits = self.model.joints().iter().flat_map(|joint| [joint.limits.lower, joint.limits.upper]);
        owned2(py, limits.collect(), self.model.n(), 2)
    }

    /// Highest speeds (n), rad/s or m/s; infinite for none.
    #[getter]
    fn velocity_limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        owned1(py, self.of_joints(|joint| joint.limits.velocity))
    }

    /// Highest torques (n), Nm or N; infinite for none.
    #[getter]
    fn effort_limits<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        owned1(py, self.of_joints(|joint| joint.limits.effort))
    }

    /// Inertias of the rotors, reflected to the joints (n), kg m² or kg. They are part of the mass matrix.
    #[getter]
    fn armature<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        owned1(py, self.model.rotor_inertia().to_vec())
    }

    /// Coulomb friction of the joints (n), Nm or N. It is no part of `bias`.
    #[getter]
    fn friction<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        owned1(py, self.friction.clone())
    }

    /// Viscous friction of the joints (n), Nms/rad or Ns/m. It is no part of `bias`.
    #[getter]
    fn damping<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        owned1(py, self.damping.clone())
    }

    /// Sets the state and computes what depends on it.
    ///
    /// q (n): positions, rad or m. dq (n): velocities, rad/s or m/s; None is rest.
    ///
    /// Raises OpspaceError for another number of values, a value that is not finite, or a link without mass.
    #[pyo3(signature = (q, dq=None))]
    fn update(&self, q: &Bound<'_, PyAny>, dq: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mut state = self.lock();
        let State { data, q: own_q, dq: own_dq, is_updated, .. } = &mut *state;
        *is_updated = false;
        vector("q", q, own_q)?;
        match dq {
            Some(dq) => vector("dq", dq, own_dq)?,
            None => own_dq.fill(0.0),
        }
        finite("q", own_q)?;
        finite("dq", own_dq)?;
        if !caught(|| update(&self.model, data, own_q, own_dq))? {
            return Err(singular_mass_matrix());
        }
        *is_updated = true;
        Ok(())
    }

    /// Positions of the last update (n).
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(owned1(py, self.updated()?.q.clone()))
    }

    /// Velocities of the last update (n).
    #[getter]
    fn dq<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(owned1(py, self.updated()?.dq.clone()))
    }

    /// Mass matrix M(q) (n, n), kg m², of M ddq + bias = torque.
    #[getter]
    fn mass_matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        // Symmetric: by rows as by columns.
        copied2(py, self.updated()?.data.mass_matrix.as_slice(), self.model.n(), self.model.n())
    }

    /// Torques C(q, dq) dq + g(q) (n), Nm or N. In pin `nle`, in MuJoCo `qfrc_bias`.
    #[getter]
    fn bias<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_slice(py, self.updated()?.data.bias.as_slice()))
    }

    /// Torques g(q) that hold the arm at rest (n), Nm or N.
    #[getter]
    fn gravity<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        Ok(PyArray1::from_slice(py, self.updated()?.data.gravity.as_slice()))
    }

    /// Pose of a frame in the world: its position (3), m, and its quaternion w, x, y, z (4) with w ≥ 0.
    ///
    /// Raises OpspaceError for an unknown frame.
    fn pose<'py>(&self, py: Python<'py>, frame: &str) -> PyResult<Pose<'py>> {
        let frame = self.frame(frame)?;
        let (position, turn) = pose(&frame_placement(&self.model, &self.updated()?.data, frame));
        Ok((PyArray1::from_slice(py, &position), PyArray1::from_slice(py, &turn)))
    }

    /// Jacobian J (6, n) of a frame: J dq is the velocity of its origin, m/s, and its angular velocity, rad/s, both in world
    /// axes. In pin LOCAL_WORLD_ALIGNED.
    ///
    /// out (6, n): an array of 64-bit floats that is filled and returned in place of a new one.
    ///
    /// Raises OpspaceError for an unknown frame, or another shape of out.
    #[pyo3(signature = (frame, out=None))]
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        frame: &str,
        out: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (frame, n) = (self.frame(frame)?, self.model.n());
        let mut state = self.updated()?;
        let State { data, jacobian, .. } = &mut *state;
        frame_jacobian(&self.model, data, frame, jacobian);
        let Some(out) = out else { return owned2(py, by_rows(jacobian), 6, n) };
        let out = out
            .cast_into::<PyArray2<f64>>()
            .map_err(|_| argument("out", "expected an array of 64-bit floats with two dimensions"))?;
        check_out("out", &out, [6, n])?;
        {
            let mut writable = out.try_readwrite().map_err(|error| argument("out", &error.to_string()))?;
            let mut view = writable.as_array_mut();
            for (joint, column) in jacobian.column_iter().enumerate() {
                for (row, value) in column.iter().enumerate() {
                    view[[row, joint]] = *value;
                }
            }
        }
        Ok(out)
    }

    /// Velocity of a frame (6): of its origin, m/s, and its angular velocity, rad/s, in world axes. It is J dq.
    ///
    /// Raises OpspaceError for an unknown frame.
    fn velocity<'py>(&self, py: Python<'py>, frame: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let frame = self.frame(frame)?;
        Ok(of_motion(py, &frame_velocity(&self.model, &self.updated()?.data, frame)))
    }

    /// Acceleration of a frame (6) without joint accelerations, dJ/dt dq: m/s² and rad/s², in world axes. In pin the classical
    /// acceleration for ddq = 0.
    ///
    /// Raises OpspaceError for an unknown frame.
    fn bias_acceleration<'py>(&self, py: Python<'py>, frame: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let frame = self.frame(frame)?;
        Ok(of_motion(py, &frame_bias_acceleration(&self.model, &self.updated()?.data, frame)))
    }

    /// Operational-space inertia Λ = (J M⁻¹ Jᵀ)⁻¹ (k, k) of a frame; kg, kg m and kg m².
    ///
    /// rows: the k rows of J that count, each once, 0 to 5: x, y, z, then the rotations about them; None is all six.
    ///
    /// Raises OpspaceError where the joints do not move the rows independently: Λ is infinite there.
    #[pyo3(signature = (frame, rows=None))]
    fn operational_inertia<'py>(
        &self,
        py: Python<'py>,
        frame: &str,
        rows: Option<Vec<usize>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let frame = self.frame(frame)?;
        let rows = rows.unwrap_or_else(|| (0..6).collect());
        let is_repeated = |(place, row): (usize, &usize)| rows[..place].contains(row);
        if rows.is_empty() || rows.iter().any(|row| *row > 5) || rows.iter().enumerate().any(is_repeated) {
            return Err(argument("rows", "expected different numbers from 0 to 5"));
        }
        let mut state = self.updated()?;
        let State { data, jacobian, space, .. } = &mut *state;
        frame_jacobian(&self.model, data, frame, jacobian);
        let mut chosen = Matrix6xX::zeros(self.model.n());
        for (to, from) in rows.iter().enumerate() {
            chosen.set_row(to, &jacobian.row(*from));
        }
        let k = rows.len();
        let inertia = caught(|| {
            space.update_inertia(&data.mass_matrix_factor, &chosen, k, Inversion::Plain, None, None);
            are_independent(data.mass_matrix_factor.mobility(&mut chosen), k).then_some(space.task_inertia)
        })?;
        let inertia = inertia.ok_or_else(|| {
            argument("rows", "the joints do not move these rows independently in this posture: Λ is infinite")
        })?;
        let numbers = (0..k).flat_map(|row| (0..k).map(move |column| inertia[(row, column)]));
        owned2(py, numbers.collect(), k, k)
    }

    /// Computes N states, without Python's lock.
    ///
    /// q (N, n): positions. dq (N, n): velocities; None is rest. frame: also its poses and Jacobians.
    ///
    /// Raises OpspaceError as `update` does, with the number of the state.
    #[pyo3(signature = (q, dq=None, frame=None))]
    fn batch(
        &self,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        dq: Option<&Bound<'_, PyAny>>,
        frame: Option<&str>,
    ) -> PyResult<Batch> {
        let n = self.model.n();
        let frame = frame.map(|frame| self.frame(frame)).transpose()?;
        let (q, count) = rows("q", q, n)?;
        let dq = match dq {
            Some(dq) => {
                let (dq, rows) = rows("dq", dq, n)?;
                if rows != count {
                    return Err(argument("dq", &format!("expected {count} rows as in q, got {rows}")));
                }
                dq
            }
            None => vec![0.0; q.len()],
        };
        finite("q", &q)?;
        finite("dq", &dq)?;
        let model = Arc::clone(&self.model);
        let computed = py.detach(|| caught(|| States::compute(&model, &q, &dq, frame)))?;
        let states = computed.ok_or_else(singular_mass_matrix)?;
        Ok(Batch {
            mass_matrix: owned3(py, states.mass_matrix, [count, n, n])?.unbind(),
            bias: owned2(py, states.bias, count, n)?.unbind(),
            gravity: owned2(py, states.gravity, count, n)?.unbind(),
            position: frame.map(|_| owned2(py, states.position, count, 3)).transpose()?.map(Bound::unbind),
            quaternion: frame
                .map(|_| owned2(py, states.quaternion, count, 4))
                .transpose()?
                .map(Bound::unbind),
            jacobian: frame
                .map(|_| owned3(py, states.jacobian, [count, 6, n]))
                .transpose()?
                .map(Bound::unbind),
        })
    }

    fn __repr__(&self) -> String {
        format!("Model('{}', n={})", self.model.name(), self.model.n())
    }
}

/// Returns the six numbers of a motion, the linear ones first.
fn of_motion<'py>(py: Python<'py>, motion: &Motion) -> Bound<'py, PyArray1<f64>> {
    owned1(py, motion.linear.iter().chain(motion.angular.iter()).copied().collect())
}

/// Results of `Model.batch` for N states.
#[pyclass(frozen, get_all, module = "opspace")]
pub(crate) struct Batch {
    /// Mass matrices (N, n, n), kg m².
    mass_matrix: Py<PyArray3<f64>>,
    /// Torques C dq + g (N, n), Nm or N.
    bias: Py<PyArray2<f64>>,
    /// Torques g (N, n), Nm or N.
    gravity: Py<PyArray2<f64>>,
    /// Positions of the frame (N, 3), m; None without a frame.
    position: Option<Py<PyArray2<f64>>>,
    /// Quaternions of the frame, w, x, y, z (N, 4); None without a frame.
    quaternion: Option<Py<PyArray2<f64>>>,
    /// Jacobians of the frame (N, 6, n), linear rows first; None without a frame.
    jacobian: Option<Py<PyArray3<f64>>>,
}

/// Results for many states, one state after the other.
#[derive(Default)]
struct States {
    mass_matrix: Vec<f64>,
    bias: Vec<f64>,
    gravity: Vec<f64>,
    position: Vec<f64>,
    quaternion: Vec<f64>,
    jacobian: Vec<f64>,
}

impl States {
    /// Computes the states with the positions `q` and velocities `dq`; `None` if the mass matrix of one is singular.
    fn compute(model: &opspace_model::Model, q: &[f64], dq: &[f64], frame: Option<FrameId>) -> Option<Self> {
        let n = model.n();
        let (mut data, mut jacobian) = (Data::new(model), Matrix6xX::zeros(n));
        let mut states = Self::default();
        states.mass_matrix.reserve(q.len() * n);
        for (q, dq) in q.chunks_exact(n.max(1)).zip(dq.chunks_exact(n.max(1))) {
            if !update(model, &mut data, q, dq) {
                return None;
            }
            states.mass_matrix.extend_from_slice(data.mass_matrix.as_slice());
            states.bias.extend_from_slice(data.bias.as_slice());
            states.gravity.extend_from_slice(data.gravity.as_slice());
            let Some(frame) = frame else { continue };
            let (position, turn) = pose(&frame_placement(model, &data, frame));
            states.position.extend(position);
            states.quaternion.extend(turn);
            frame_jacobian(model, &data, frame, &mut jacobian);
            states.jacobian.extend(by_rows(&jacobian));
        }
        Some(states)
    }
}

/// Position and quaternion w, x, y, z of a placement.
fn pose(placement: &Placement) -> ([f64; 3], [f64; 4]) {
    let turn = quaternion(&placement.rotation);
    (placement.translation.into(), [turn.w, turn.i, turn.j, turn.k])
}

/// Numbers of a Jacobian, row by row.
fn by_rows(jacobian: &Matrix6xX<f64>) -> Vec<f64> {
    let mut numbers = Vec::with_capacity(jacobian.len());
    (0..6).for_each(|row| numbers.extend(jacobian.row(row).iter()));
    numbers
}

/// True if the first `k` rows of Λ⁻¹ are independent.
fn are_independent(mobility: Matrix6<f64>, k: usize) -> bool {
    let eigenvalues = SymmetricEigen::new(mobility.view((0, 0), (k, k)).into_owned()).eigenvalues;
    eigenvalues.min() > SINGULAR * eigenvalues.max()
}

fn finite(name: &str, values: &[f64]) -> PyResult<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(place) => {
            Err(argument(name, &format!("value {place} is {}, which is not finite", values[place])))
        }
        None => Ok(()),
    }
}

fn singular_mass_matrix() -> PyErr {
    refused(
        "the mass matrix is not positive definite: a joint moves no mass",
        Some("give its link an inertia, or its joint an armature"),
    )
}
