//! `opspace identify`: identification of a robot's servos by moving its joints, and the files with the results.
//!
//! [`opspace_identify`] performs the identification. This module reads the robot from its file, and writes the
//! results as a section of robot.toml, as a complete robot.toml, as JSON and as an HTML page.

pub mod identification_page;
mod static_joints;
mod toml_output;

use nalgebra::DMatrix;
use opspace_backend::quantity::Positive;
use opspace_backend::{Backend, CommandKind, World};
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::files::robot::RobotDefinition;
use opspace_experiment::files::source::FileError;
use opspace_experiment::run::execute::Progress;
use opspace_experiment::run::start_positions::check_start;
use opspace_experiment::suggest::choices;
use opspace_identify::response::Point;
use opspace_identify::session::{AbortReason, ExcitationSession};
use opspace_identify::static_identification::Evaluation;
use opspace_identify::static_identification::plan::{PlanFailure, SweepPlan};
use opspace_identify::{ExcitationPlan, Identification, KnownParameters, TorqueScale, identify};
use opspace_loop::RealTime;
use opspace_model::{Data, JointKind, crba, kinematics};
use opspace_sim::parameters::SimulatedParameters;
use opspace_sim::{ArmConfig, SimulatedArm};
use opspace_transformer::{CascadedServo, IdentifiedKeys, PidServo, ProfileParameters, ServoParameters};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

/// Request for an identification.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Profile of the robot; the default profile if `None`.
    pub profile: Option<String>,
    /// Joint to identify; all joints if `None`.
    pub joint: Option<String>,
    /// Joint positions during the identification, by name, rad or m. Joints that are not listed are at the middle of
    /// their range.
    pub start_rad: Vec<(String, f64)>,
    /// Excitation of the joints.
    pub plan: ExcitationPlan,
    /// Weight with which static identifications are repeated.
    pub hung_weight: Option<HungWeight>,
}

/// Weight of known mass that hangs on the arm.
#[derive(Clone, Debug, PartialEq)]
pub struct HungWeight {
    /// Link or tool on whose origin it hangs.
    pub frame: String,
    /// Mass, kg.
    pub mass_kg: Positive,
}

/// Checked request for an identification of a robot's servos.
#[derive(Clone, Debug)]
pub struct IdentificationJob {
    robot: RobotDefinition,
    profile_name: String,
    profile: ProfileParameters,
    start: Vec<f64>,
    joints: Vec<usize>,
    /// Structure of the servo of each of these joints.
    structures: Vec<Structure>,
    plan: ExcitationPlan,
    hung_weight: Option<HungWeight>,
    /// Planned sweep of each of these joints that is identified statically.
    sweeps: Vec<Option<Result<SweepPlan, PlanFailure>>>,
}

/// An identified joint.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct JointIdentification {
    /// Name of the joint.
    #[serde(skip)]
    pub name: String,
    /// Parameters of the joint that are known before the identification.
    #[serde(skip)]
    pub known: KnownParameters,
    /// Structure of the servo according to robot.toml.
    #[serde(skip)]
    pub structure: Structure,
    /// Position of the joint before its excitation, rad (m).
    pub position_rad: f64,
    /// Inertia of the joint from URDF and rotor, kg m² (kg): with the other joints free, and with them held.
    pub urdf_inertia_kg_m2: Option<[f64; 2]>,
    /// Planned sweep, if the joint is identified statically.
    #[serde(skip)]
    pub sweep: Option<SweepPlan>,
    /// Result of the identification.
    #[serde(flatten)]
    pub found: Identification,
    /// D* measured at the largest amplitude: frequency (Hz), real and imaginary part (Nm/rad).
    pub effective_servo: Vec<[f64; 3]>,
    /// Reason why the joint cannot be driven by torques; null if it can.
    pub no_torque_mode: Option<String>,
}

/// Structure of a servo that can be identified.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Structure {
    /// Name in files.
    pub name: &'static str,
    /// Method that identifies it.
    pub method: Method,
}

/// Method of an identification.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Method {
    /// Responses to multisines, with the keys and values of identified gains.
    Multisines(IdentifiedKeys),
    /// Offsets under the weight of the arm, for this declared servo.
    Static(PidServo),
}

/// Results of the identification of a robot.
#[derive(Clone, Debug)]
pub struct IdentificationResults {
    /// Robot whose joints were moved.
    pub robot: RobotDefinition,
    /// Name of its profile.
    pub profile_name: String,
    profile: ProfileParameters,
    /// Identified joints, in the order of identification.
    pub joints: Vec<JointIdentification>,
    /// Duration of the robot's motion, measured by the robot's clock, s.
    pub robot_s: f64,
    seed: u64,
    /// Static identifications, to which a measurement with a hung weight adds.
    evaluations: BTreeMap<usize, Evaluation>,
}

/// Contents of `identification.json`.
#[derive(Serialize)]
struct Json<'a> {
    schema: &'static str,
    opspace_version: &'static str,
    robot: String,
    profile: &'a str,
    servo_hz: f64,
    ratio: u32,
    seed: u64,
    robot_s: f64,
    /// Delay of the servos, servo ticks; null if it differs between joints.
    delay_servo_ticks: Option<u32>,
    joints: BTreeMap<&'a str, &'a JointIdentification>,
}

impl IdentificationJob {
    /// Checks a request against the robot.
    ///
    /// # Errors
    /// Unknown names, positions outside the limits, a robot that does not accept positions, and servos with a
    /// structure that cannot be identified.
    pub fn new(robot: RobotDefinition, request: Request) -> Result<Self, FileError> {
        let (name, profile) = robot.profile(request.profile.as_deref())?;
        let (profile_name, profile) = (name.to_owned(), profile.clone());
        if robot.file.interface.command != CommandKind::Position {
            let message = format!(
                "this robot accepts {}: only the position servos of a robot that accepts joint positions can be identified",
                match robot.file.interface.command {
                    CommandKind::Torque => "torques",
                    _ => "joint velocities",
                }
            );
            let help = "take friction and gains from data sheets and the settings of the drives; if the robot also accepts \
                        positions, write command = \"position\" and its servos, and identify that robot";
            return Err(FileError::at_key(
                &robot.source,
                "interface.command",
                message,
                Some(help.to_owned()),
            ));
        }
        let joint = |name: &str| {
            robot.model.joint(name).map_err(|unknown| {
                let message = format!("this robot has no joint '{name}'");
                FileError::of_file(robot.source.name(), message, Some(choices(name, &unknown.known)))
            })
        };
        let joints = match &request.joint {
            Some(name) => vec![joint(name)?],
            None => (0..robot.model.n()).collect(),
        };
        let mut start: Vec<f64> = (robot.model.joints().iter())
            .map(|j| 0.5 * (j.limits.lower + j.limits.upper))
            .map(|middle| if middle.is_finite() { middle } else { 0.0 })
            .collect();
        for (name, value) in &request.start_rad {
            let at = joint(name)?;
            check_start(&robot.model.joints()[at].limits, *value).map_err(|(message, help)| {
                FileError::of_file(
                    robot.source.name(),
                    format!("start of joint '{name}': {message}"),
                    Some(help),
                )
            })?;
            start[at] = *value;
        }
        let (plan, structures, hung_weight, sweeps) =
            (request.plan, Vec::new(), request.hung_weight, Vec::new());
        let job = Self { robot, profile_name, profile, start, joints, plan, structures, hung_weight, sweeps };
        let structures = job.joints.iter().map(|&joint| job.structure(joint)).collect::<Result<_, _>>()?;
        let job = Self { structures, ..job };
        let sweeps = job.plan_sweeps()?;
        Ok(Self { sweeps, ..job })
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RobotDefinition {
        &self.robot
    }

    /// Number of joints that will be identified.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Returns the simulated robot, at rest in the start posture of the identification.
    ///
    /// # Errors
    /// A robot file without `[simulated]`, or parameters that contradict each other.
    pub fn simulated_arm(&self) -> Result<SimulatedArm, FileError> {
        self.simulate(|_| {})
    }

    /// Returns the simulated robot after a change of its plant.
    fn simulate(&self, change: impl FnOnce(&mut SimulatedParameters)) -> Result<SimulatedArm, FileError> {
        let robot = &self.robot;
        let Some(mut simulated) = robot.file.simulated.clone() else {
            let help = "add [simulated]; `opspace schema robot` lists its keys".to_owned();
            let message = "this robot has no [simulated] section, so there is no robot to identify";
            return Err(FileError::of_file(robot.source.name(), message, Some(help)));
        };
        change(&mut simulated);
        let servos = match robot.servos(&self.profile) {
            declared if declared.is_empty() => self.simulated_servos(&simulated.servo)?,
            declared => declared,
        };
        let setup = ArmConfig {
            model: robot.model.clone(),
            joints: robot.joints(),
            servos,
            profile: self.profile.clone(),
            capabilities: robot.capabilities(CommandKind::Position, self.profile.period_s()).simulated(),
            simulated,
            environment: Vec::new(),
            capsules: Vec::new(),
            external_forces: false,
            start: self.start.clone(),
            rest_s: 0.0,
            seed: self.plan.seed,
        };
        SimulatedArm::new(setup).map_err(|e| FileError::of_file(robot.source.name(), e.to_string(), None))
    }

    /// Returns the servos of the simulated robot, of a file that declares none.
    fn simulated_servos(
        &self,
        servos: &BTreeMap<String, ServoParameters>,
    ) -> Result<Vec<ServoParameters>, FileError> {
        let joints = self.robot.model.joints().iter();
        let found: Vec<ServoParameters> = joints.filter_map(|j| servos.get(&j.name).cloned()).collect();
        if found.len() == self.robot.model.n() {
            return Ok(found);
        }
        let profile = &self.profile_name;
        let message = format!("profile '{profile}' has no position servos, so there is nothing to simulate");
        let help = "add [simulated.servo.JOINT.cascaded] for each joint: the servos of the simulated robot, which the \
                    identification does not know; a real robot needs none";
        Err(FileError::at_key(&self.robot.source, "simulated", message, Some(help.to_owned())))
    }

    /// Real-time scheduling as `[driver]` asks for it, while a real robot is driven.
    fn real_time(&self, robot: &dyn Backend) -> Option<RealTime> {
        let is_real = robot.capabilities().world == World::Real;
        // A wrong value is refused before the robot is opened.
        let parameters = self.robot.real_time().ok().filter(|_| is_real);
        parameters.map(RealTime::enter)
    }

    /// Identifies the joints one after the other, on any robot that is in the start posture of the identification.
    /// Calls `begun` with the name of each joint before its identification.
    ///
    /// # Errors
    /// The fault of the robot, or the interruption, that ended the identification.
    pub fn run(
        &self,
        robot: &mut dyn Backend,
        watch: &Progress,
        mut begun: impl FnMut(&str),
    ) -> Result<IdentificationResults, AbortReason> {
        let ended = |ticks: u64| {
            watch.ticks.store(ticks, Ordering::Relaxed);
            watch.interrupt.load(Ordering::Relaxed)
        };
        let kinds: Vec<JointKind> = self.robot.model.joints().iter().map(|joint| joint.kind).collect();
        let _real_time = self.real_time(robot);
        let mut session = ExcitationSession::begin(robot, &kinds, &ended)?;
        let mut joints = Vec::new();
        let evaluations = self.run_static(&mut session, &mut begun)?;
        for (index, (&joint, &structure)) in self.joints.iter().zip(&self.structures).enumerate() {
            let name = &self.robot.model.joints()[joint].name;
            let told = self.known_parameters(joint);
            let found = match evaluations.get(&joint) {
                Some(evaluation) => Identification::from_static(evaluation.clone()),
                None => {
                    begun(name);
                    identify(&mut session, &told, &self.plan)?
                }
            };
            joints.push(JointIdentification {
                name: name.clone(),
                structure,
                position_rad: session.posture(joint),
                urdf_inertia_kg_m2: told.inertia,
                effective_servo: effective_servo(&found),
                no_torque_mode: found.no_torque_mode(),
                known: told,
                sweep: self.sweeps[index].clone().and_then(Result::ok),
                found,
            });
        }
        Ok(IdentificationResults {
            robot: self.robot.clone(),
            profile_name: self.profile_name.clone(),
            profile: self.profile.clone(),
            robot_s: session.ticks() as f64 * session.period_s(),
            joints,
            seed: self.plan.seed,
            evaluations,
        })
    }

    /// Returns the parameters of a joint that are known before the identification: not servo gains, friction or
    /// delay.
    fn known_parameters(&self, joint: usize) -> KnownParameters {
        let limits = &self.robot.model.joints()[joint].limits;
        let drive = &self.robot.joints()[joint];
        let rotor_known = drive.rotor.inertia_kg_m2.get() > 0.0;
        KnownParameters {
            joint,
            servo_period_s: self.profile.servo_period_s(),
            servo_ticks_per_cycle: self.profile.servo_ticks_per_cycle.get(),
            setpoints: self.robot.file.interface.setpoints,
            lower: limits.lower,
            upper: limits.upper,
            speed_limit: limits.velocity,
            torque_limit: drive.torque_limit_nm.get(),
            resolution: drive.rotor.resolution_rad(),
            inertia: rotor_known.then(|| self.inertia(joint)),
            viscous_friction: drive.friction.viscous_nms_per_rad.get(),
        }
    }

    /// Inertia of a joint in the start posture, kg m² (kg): with the other joints free, 1/(M⁻¹)_ii, and held, M_ii.
    fn inertia(&self, joint: usize) -> [f64; 2] {
        let model = &self.robot.model;
        let mut data = Data::new(model);
        kinematics(model, &mut data, &self.start, &vec![0.0; model.n()]);
        crba(model, &mut data);
        let mass: &DMatrix<f64> = &data.mass_matrix;
        let held = mass[(joint, joint)];
        let free = mass.clone().try_inverse().map_or(held, |inverse| 1.0 / inverse[(joint, joint)]);
        [free, held]
    }

    fn structure(&self, joint: usize) -> Result<Structure, FileError> {
        let name = &self.robot.model.joints()[joint].name;
        let servos = self.robot.servos(&self.profile);
        // Without a declared structure it is the cascade, to which a PID servo is equivalent.
        let default = || {
            let any = Positive::literal(1.0);
            ServoParameters::Cascaded(CascadedServo::new(any, any, any))
        };
        let servo = servos.get(joint).cloned().unwrap_or_else(default);
        if let Some(method) = self.static_method(&servo, name)? {
            return Ok(Structure { name: servo.name(), method });
        }
        let what = match servo.structure().identified() {
            _ if servo.acceleration_feed_forward_kg_m2() != 0.0 => "with acceleration feed-forward",
            Ok(keys) => return Ok(Structure { name: servo.name(), method: Method::Multisines(keys) }),
            Err(what) => what,
        };
        let key = ["profile", &self.profile_name, "servo", name];
        let message = format!("the servo of joint '{name}' is {what}, which cannot be identified");
        let help = "supported are cascaded servos without an integral, and PID servos without an integral whose derivative is of \
             the position, both without acceleration feed-forward";
        Err(FileError::at_key(&self.robot.source, key, message, Some(help.to_owned())))
    }
}

fn effective_servo(found: &Identification) -> Vec<[f64; 3]> {
    let points = found.measured.first().map_or(&[][..], |m| &m.position);
    let point = |p: &Point| found.effective_servo(p.hz, p.value).map(|d| [p.hz, d.re, d.im]);
    points.iter().filter_map(point).collect()
}

impl JointIdentification {
    /// True if the joint was identified statically.
    #[must_use]
    pub fn is_static(&self) -> bool {
        matches!(self.structure.method, Method::Static(_))
    }

    /// Cell of a table that says if the results are accepted.
    fn acceptance(&self) -> Cell {
        match &self.no_torque_mode {
            None if self.found.doubts.is_empty() => Cell::Pass("accepted".to_owned()),
            None => Cell::Text("doubtful".to_owned()),
            Some(_) => Cell::Fail("refused".to_owned()),
        }
    }
}

impl IdentificationResults {
    /// True if every joint can be driven by torques.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.joints.iter().all(|j| j.no_torque_mode.is_none())
    }

    /// Returns the delay of most joints, servo ticks, and true if all joints have this delay.
    fn delay(&self) -> Option<(u32, bool)> {
        let delays: Vec<u32> =
            self.joints.iter().filter_map(|j| j.found.servo.as_ref()).map(|s| s.delay).collect();
        let count = |delay: u32| delays.iter().filter(|d| **d == delay).count();
        let most = delays.iter().copied().max_by_key(|&d| count(d))?;
        Some((most, count(most) == delays.len()))
    }

    /// Tables of the identified parameters of the joints that were identified with multisines, and of those that were identified
    /// statically, which are marked.
    #[must_use]
    pub fn tables(&self) -> Vec<(bool, Table)> {
        let (of_static, others): (Vec<_>, Vec<_>) = self.joints.iter().partition(|joint| joint.is_static());
        let mut tables = Vec::new();
        if !others.is_empty() {
            tables.push((false, Self::table(&others)));
        }
        if !of_static.is_empty() {
            tables.push((true, Self::static_table(&of_static)));
        }
        tables
    }

    /// Table of the parameters of joints that were identified with multisines.
    fn table(joints: &[&JointIdentification]) -> Table {
        let mut table = Table::new(&[
            ("joint", ""),
            ("kp", "1/s"),
            ("kv", "Nms/rad"),
            ("filter", "Hz"),
            ("delay", "ticks"),
            ("inertia", "kg m²"),
            ("Coulomb", "Nm"),
            ("static", "Nm"),
            ("viscous", "Nms/rad"),
            ("torque scale from", ""),
            ("bandwidth", "Hz"),
            ("T error", "%"),
            ("torque error", "%"),
            ("distortion", "%"),
            ("torque mode", ""),
        ]);
        for joint in joints {
            let servo = joint.found.servo.as_ref();
            let trust = joint.found.fit_quality.as_ref();
            let friction = servo.and_then(|s| s.friction);
            let percent = |share: f64| Cell::Number(100.0 * share);
            let scale = match joint.found.scale {
                TorqueScale::MotorCurrent => "motor current",
                TorqueScale::Urdf => "URDF and rotor",
                TorqueScale::Gravity => "gravity of the URDF",
                TorqueScale::Unknown => "none: relative to inertia",
            };
            table.push(vec![
                joint.name.as_str().into(),
                servo.map(|s| s.kp).into(),
                servo.map(|s| s.kv).into(),
                servo.map(|s| s.velocity_filter_hz).into(),
                servo.map(|s| u64::from(s.delay)).into(),
                servo.map(|s| s.inertia).into(),
                friction.map(|f| f.coulomb).into(),
                friction.map(|f| f.static_friction).into(),
                friction.map(|f| f.viscous).into(),
                scale.into(),
                trust.map(|t| t.bandwidth_hz).into(),
                trust.map_or(Cell::Empty, |t| percent(t.position_residual)),
                trust.and_then(|t| t.torque_residual).map_or(Cell::Empty, percent),
                joint.found.measured.first().map_or(Cell::Empty, |m| percent(m.distortion.total())),
                joint.acceptance(),
            ]);
        }
        table
    }

    /// States in a line how many joints were identified.
    #[must_use]
    pub fn verdict(&self) -> String {
        let refused = self.joints.iter().filter(|joint| joint.no_torque_mode.is_some()).count();
        let is_doubtful =
            |joint: &&JointIdentification| joint.no_torque_mode.is_none() && !joint.found.doubts.is_empty();
        let doubtful = self.joints.iter().filter(is_doubtful).count();
        let (all, known) = (self.joints.len(), self.joints.len() - refused);
        format!(
            "{known} of {all} joints identified: {} accepted, {doubtful} doubtful, {refused} refused",
            known - doubtful
        )
    }

    /// All results in the format of `identification.json`.
    #[must_use]
    pub fn json(&self) -> impl Serialize + '_ {
        Json {
            schema: "opspace.identification/1",
            opspace_version: env!("CARGO_PKG_VERSION"),
            robot: self.robot.name(),
            profile: &self.profile_name,
            servo_hz: self.profile.servo_hz.get(),
            ratio: self.profile.servo_ticks_per_cycle.get(),
            seed: self.seed,
            robot_s: self.robot_s,
            delay_servo_ticks: self.delay().and_then(|(delay, all)| all.then_some(delay)),
            joints: self.joints.iter().map(|j| (j.name.as_str(), j)).collect(),
        }
    }
}
