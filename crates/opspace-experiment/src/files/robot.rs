//! robot.toml: nominal parameters of a robot, and parameters of its simulation.

use crate::files::collision::{CollisionFile, RobotCapsules, robot_capsules};
use crate::files::interface::InterfaceParameters;
use crate::files::joint_layers::{Groups, UrdfValue, check_layers, expand, groups, urdf_layer, urdf_values};
use crate::files::layered_path::{inner, stated_path};
use crate::files::link::LinkFile;
use crate::files::missing::{Purpose, check_complete};
use crate::files::mount::MountFile;
use crate::files::origin::{Files, Kind, beside};
use crate::files::overrides;
use crate::files::robot_part::{PartKeys, UsedPart, load_part, urdf_error};
use crate::files::sensor_loads::{Sensor, sensor_loads};
use crate::files::source::{FileError, KeyPath, Source, checked, explain, parse};
use crate::files::strict::Strict;
use crate::files::toml_path::{depth_of, dotted, keys_at, value_at};
use crate::files::tool::{self, ToolFile};
use crate::suggest::{choices, list};
use opspace_backend::quantity::Positive;
use opspace_backend::{Capabilities, CommandKind, MAX_DELAY_CYCLES, Measured, Setting};
use opspace_control::JointLimits;
use opspace_loop::{
    CollisionDetectionParameters, CollisionReaction, EstimatedForceParameters, SafetyParameters,
    SensorBiasParameters, SensorEstimateParameters, SensorLoadParameters,
};
use opspace_model::collision::{CapsuleWarning, LinkCapsule};
use opspace_model::{
    FrameId, Inertia, JointDynamics, Limits, MasslessJoint, Model, ParsedUrdf, UrdfOptions, UrdfWarning,
};
use opspace_sim::SimulatedParameters;
use opspace_sim::parameters::SensorLoadParameters as TrueLoad;
use opspace_transformer::parameters::SERVO_RATES_HZ;
use opspace_transformer::{
    ClosedLoopModel, Gears, JointParameters, ProfileParameters, ServoLaw, ServoParameters,
};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Contents of a robot file.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct RobotFile {
    /// URDF of the robot; the path is relative to this file.
    pub urdf: PathBuf,
    /// Name of the default profile.
    #[cfg_attr(feature = "schema", schemars(with = "Option<String>", extend("x-default" = "the only profile")))]
    pub default_profile: String,
    /// Placement of the base in the world: for an arm on a wall, a ceiling or a slope, or beside another one. If absent, the base
    /// is at the origin, upright.
    pub mount: Option<MountFile>,
    /// Masses and inertias of links of the URDF, by name, in place of those that it states, or for links for which it states none.
    #[serde(default)]
    pub link: BTreeMap<String, LinkFile>,
    /// Joints of the URDF that do not move, each with its position, rad (m).
    #[serde(default)]
    pub locked_joints: BTreeMap<String, f64>,
    /// Chain of links that is used; joints elsewhere do not move: they are at `locked_joints`, or at the position closest to
    /// zero.
    #[serde(rename = "use")]
    pub used: Option<UsedPart>,
    /// True if mimic joints of the URDF move with the joints that they mimic; otherwise they are joints of their own.
    #[serde(default)]
    pub enforce_mimic: bool,
    /// Keys of this file whose values, and all below them, are assumed: results rest on them. Remove a key when its value is
    /// known.
    #[serde(default)]
    pub assumed: Vec<String>,
    /// Interface of the robot: commands, measurements and behaviour of the drives.
    pub interface: InterfaceParameters,
    /// Drive of each moving joint of the URDF, by joint name. A value that is absent is that of the joint's group, of
    /// `joint_defaults`, or of the URDF, which has torque limits (effort) and friction (damping, friction).
    pub joint: BTreeMap<String, JointParameters>,
    /// Values of all joints that state no other.
    #[serde(default, rename = "joint_defaults")]
    #[cfg_attr(feature = "schema", schemars(with = "Option<JointParameters>"))]
    _joint_defaults: IgnoredAny,
    /// Groups of joints, by name: values of the joints of a group that state no other. Each joint is in one group at most.
    #[serde(default, rename = "group")]
    #[cfg_attr(feature = "schema", schemars(with = "BTreeMap<String, JointGroup>"))]
    _group: IgnoredAny,
    /// Profiles (sets of rates and servo parameters) of the robot, by name.
    pub profile: BTreeMap<String, ProfileParameters>,
    /// Force sensors, by name.
    #[serde(default)]
    pub force_sensor: BTreeMap<String, ForceSensorFile>,
    /// Forces that are estimated from the torques of the motors, by name: tasks use them like those of force sensors.
    #[serde(default)]
    pub estimated_force: BTreeMap<String, EstimatedForceParameters>,
    /// Tools and loads mounted on the robot, by name: a gripper, a screwdriver, a load.
    #[serde(default)]
    pub tool: BTreeMap<String, ToolFile>,
    /// Distances that are kept between links and from the obstacles of a task; none if absent.
    pub collision: Option<CollisionFile>,
    /// Detection of collisions from the torques of the motors; none if absent.
    pub collision_detection: Option<CollisionDetectionParameters>,
    /// Safety parameters: torque ramp, rest before the start, limit margin, missed cycles and watchdog.
    #[serde(default)]
    pub safety: SafetyParameters,
    /// Connection to the real robot: `name` selects a driver in the program, the other keys are settings of the
    /// driver. If absent, the robot is simulated. Every driver has `real_time`, the scheduling of the control thread: "auto" takes
    /// SCHED_FIFO and locked memory where the machine allows them (default), "required" refuses any other machine, "off" asks for
    /// nothing; and `real_time_priority`, 1 to 99 (default 80).
    pub driver: Option<BTreeMap<String, Setting>>,
    /// Parameters of the simulated robot; if absent, the robot cannot be simulated.
    pub simulated: Option<SimulatedParameters>,
}

/// Group of joints, for the schema.
#[cfg(feature = "schema")]
#[derive(JsonSchema)]
#[expect(dead_code, reason = "groups are expanded before a file is read")]
struct JointGroup {
    /// Names of the joints.
    joints: Vec<String>,
    #[serde(flatten)]
    values: JointParameters,
}

/// A six-axis force sensor.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct ForceSensorFile {
    /// URDF link whose origin and axes are those of the measurements.
    pub frame: String,
    /// Load beyond the sensor, whose weight is taken off the readings. By default that of the links and tools beyond the frame: it
    /// is stated only if they do not have it.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the links and tools beyond")))]
    pub load: Option<SensorLoadParameters>,
    /// Bias of the readings without load; by default the mean reading at rest before control begins, when nothing
    /// may touch.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the mean reading at rest")))]
    pub bias: Option<SensorBiasParameters>,
    /// Estimation of the bias and of the load beyond the sensor while nothing touches. Without it the bias is that at rest
    /// before control begins, and the load is the stated one.
    pub estimate: Option<SensorEstimateParameters>,
}

/// Robot definition, read from its files and checked.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct RobotDefinition {
    /// Text of the robot file, with settings applied.
    pub source: Source,
    /// Text of the URDF.
    pub urdf: Source,
    /// Parameters in the robot file.
    pub file: RobotFile,
    /// Rigid-body model, including rotors and tools.
    pub model: Model,
    /// Mass of the links that cannot move, kg. They are not part of the model.
    pub standing_kg: f64,
    /// Values that the URDF states and the robot file does not.
    pub urdf_values: Vec<UrdfValue>,
    /// Joints that move no mass. Only the kinematics of such a robot are known.
    pub massless: Vec<MasslessJoint>,
    /// Warnings about the URDF.
    pub warnings: Vec<UrdfWarning>,
    /// Force sensors, sorted by name, and after them the estimated forces, sorted by name.
    pub sensors: Vec<(String, FrameId)>,
    /// Force sensors without a stated load, with the links and tools beyond them, some of which joints move.
    pub unknown_loads: BTreeMap<String, Vec<String>>,
    /// Capsules of the links, if the robot file has `[collision]`.
    pub(crate) capsules: Option<RobotCapsules>,
}

impl RobotDefinition {
    /// Reads a robot from its folder or its `robot.toml`. `settings` change values in the file.
    ///
    /// # Errors
    /// Mistakes in the file or its URDF, each with its place.
    pub fn load(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        Self::load_for(Purpose::Control, files, path, settings)
    }

    /// Reads a robot whose servos and friction are to be identified. The file may lack the gains of its position servos, and
    /// friction, which is then zero.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn load_to_identify(files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        Self::load_for(Purpose::Identification, files, path, settings)
    }

    fn load_for(purpose: Purpose, files: Files, path: &Path, settings: &[String]) -> Result<Self, FileError> {
        let path = files.robot_file(path);
        let source = files.read(&path)?;
        Kind::Robot.require(&source)?;
        let source = overrides::apply_below(&source, "robot", settings)?;
        let path_of_urdf = parse::<PartKeys>(&source)?.urdf;
        let urdf = files.read_named(&beside(&path, &path_of_urdf), &source, "urdf")?;
        Self::new(source, urdf, None, purpose)
    }

    /// Creates a robot definition from the texts of its files.
    ///
    /// # Errors
    /// As [`load`](Self::load).
    pub fn from_sources(source: Source, urdf: Source) -> Result<Self, FileError> {
        Self::new(source, urdf, None, Purpose::Control)
    }

    /// Creates a robot definition from the texts of its files and capsules that were generated before: the meshes may be
    /// missing now.
    pub(crate) fn from_sources_with(
        source: Source,
        urdf: Source,
        generated: Option<Vec<LinkCapsule>>,
    ) -> Result<Self, FileError> {
        Self::new(source, urdf, generated, Purpose::Control)
    }

    fn new(
        source: Source,
        urdf: Source,
        generated: Option<Vec<LinkCapsule>>,
        purpose: Purpose,
    ) -> Result<Self, FileError> {
        let loaded = load_part(&source, &urdf, &parse(&source)?)?;
        let mut model = loaded.model;
        let (mut file, urdf_values) = read(&source, &model, &loaded.dynamics, purpose)?;
        check_assumed(&source, &file.assumed)?;
        let mut rotors = Vec::new();
        for (i, joint) in joints_of(&source, &model, &file.joint, &["joint"])?.into_iter().enumerate() {
            rotors.push(joint.rotor.reflected_inertia());
            if let Some(velocity) = joint.velocity_limit_rad_per_s {
                let limits = model.joints()[i].limits;
                model.set_limits(i, Limits { velocity: velocity.get(), ..limits });
            }
        }
        for (name, profile) in &file.profile {
            check_rate(&source, name, profile)?;
            check_servos(&source, &model, name, profile)?;
            if !profile.identified.is_empty() {
                joints_of(&source, &model, &profile.identified, &["profile", name, "identified"])?;
            }
            check_setpoint_limits(&source, &model, name, profile)?;
            let (delay, ratio) = (profile.delay(), profile.servo_ticks_per_cycle.get());
            let most = MAX_DELAY_CYCLES.saturating_mul(ratio);
            if delay > most {
                let key = ["profile", name, "delay_servo_ticks"];
                let message = format!(
                    "a delay of {delay} servo ticks is longer than {MAX_DELAY_CYCLES} interface periods, {most} servo ticks"
                );
                return Err(FileError::at_key(&source, key, message, None));
            }
        }
        check_values(&source, &file, &model)?;
        tool::mount(&source, &mut model, &file.tool)?;
        let mut sensors = force_sensors(&source, &model, &file.force_sensor)?;
        sensors.extend(estimated_forces(&source, &model, &file)?);
        let unknown_loads = set_loads((&source, &urdf), (&model, &loaded.link_inertias), &mut file)?;
        let model = model.with_rotor_inertia(&rotors);
        let model = match &file.mount {
            Some(mount) => {
                mount.check(&source)?;
                let base = mount.placement() * model.base();
                model.with_base(base)
            }
            None => model,
        };
        let capsules = match &file.collision {
            Some(collision) => Some(robot_capsules(&source, &model, collision, &urdf, generated)?),
            None => None,
        };
        let robot = Self {
            source,
            urdf,
            file,
            model,
            standing_kg: loaded.standing_kg,
            urdf_values,
            massless: loaded.massless,
            warnings: loaded.warnings,
            sensors,
            unknown_loads,
            capsules,
        };
        robot.profile(None)?;
        Ok(robot)
    }

    /// Checks that each joint moves a mass, as dynamics need it.
    ///
    /// # Errors
    /// The first joint that moves none.
    pub fn require_masses(&self) -> Result<(), FileError> {
        self.massless.first().map_or(Ok(()), |joint| Err(urdf_error(&self.urdf, &joint.error())))
    }

    /// Name of the robot: that of its folder, or else that of its URDF.
    #[must_use]
    pub fn name(&self) -> String {
        let folder = Path::new(self.source.name()).parent().and_then(Path::file_name);
        folder.map_or_else(|| self.model.name().to_owned(), |n| n.to_string_lossy().into_owned())
    }

    /// Capabilities of the robot according to its file, with the given command interface and interface period (s). In
    /// addition to the interface that the file declares, any arm can be simulated as a torque or velocity robot.
    #[must_use]
    pub fn capabilities(&self, command: CommandKind, period_s: f64) -> Capabilities {
        let interface = &self.file.interface;
        let joints = self.model.joints().iter().map(|joint| joint.name.clone());
        let stated = Capabilities::new(joints, command, period_s)
            .measuring(&interface.measured)
            .with_setpoints(interface.setpoints)
            .with_gravity_compensated_by(interface.gravity_compensated_by);
        // Torques can't bring a robot to rest within limits of setpoints.
        let on_stop = interface.on_stop.filter(|_| command != CommandKind::Torque).unwrap_or(stated.on_stop);
        let stated = stated.with_on_stop(on_stop);
        let brakes = if command == CommandKind::Velocity { interface.brakes } else { stated.has_brakes };
        let sensors = self.file.force_sensor.iter();
        sensors.fold(stated.with_brakes(brakes), |stated, (name, sensor)| {
            stated.with_force_sensor(name, &sensor.frame)
        })
    }

    /// Returns the name and the parameters of a profile; the default profile if `name` is `None`.
    ///
    /// # Errors
    /// An unknown name.
    pub fn profile(&self, name: Option<&str>) -> Result<(&str, &ProfileParameters), FileError> {
        let wanted = name.unwrap_or(&self.file.default_profile);
        let found = self.file.profile.get_key_value(wanted);
        found.map(|(name, profile)| (name.as_str(), profile)).ok_or_else(|| {
            let message = format!("no profile '{wanted}'");
            let help = Some(choices(wanted, self.file.profile.keys()));
            match name {
                None => FileError::at_key(&self.source, "default_profile", message, help),
                Some(_) => FileError::of_file(self.source.name(), message, help),
            }
        })
    }

    /// Drives, in the model's joint order.
    #[must_use]
    pub fn joints(&self) -> Vec<JointParameters> {
        self.in_order(&self.file.joint)
    }

    /// Position servos of a profile, in the model's joint order; empty if it has none.
    #[must_use]
    pub fn servos(&self, profile: &ProfileParameters) -> Vec<ServoParameters> {
        self.in_order(&profile.servo)
    }

    /// Velocity servos of a profile, in the model's joint order; empty if it has none.
    #[must_use]
    pub fn velocity_servos(&self, profile: &ProfileParameters) -> Vec<ServoParameters> {
        self.in_order(&profile.velocity_servo).into_iter().map(ServoParameters::Velocity).collect()
    }

    /// Returns the servos that a robot with the given command interface uses, in the model's joint order. For a
    /// torque robot these are its position servos, if any: they may hold it when no command arrives.
    ///
    /// # Errors
    /// If the robot accepts positions or velocities, and the profile has no servos of that kind.
    pub fn servos_for(
        &self,
        profile_name: &str,
        command: CommandKind,
    ) -> Result<Vec<ServoParameters>, FileError> {
        let (name, profile) = self.profile(Some(profile_name))?;
        let (position, velocity) = (self.servos(profile), self.velocity_servos(profile));
        let (servos, section, keys) = match command {
            CommandKind::Velocity => {
                (velocity, "velocity_servo.JOINT", "kv_nms_per_rad and velocity_filter_hz")
            }
            CommandKind::Torque if position.is_empty() => (velocity, "servo.JOINT.cascaded", "its gains"),
            CommandKind::Torque | CommandKind::Position => (position, "servo.JOINT.cascaded", "its gains"),
        };
        // The brakes of a torque robot hold it.
        if servos.is_empty() && self.model.n() > 0 && command != CommandKind::Torque {
            let message = format!(
                "profile '{name}' has no {} servos, which a {} robot needs",
                if command == CommandKind::Velocity { "velocity" } else { "position" },
                command.name()
            );
            let help = format!("add [profile.{name}.{section}] for each joint, with {keys}");
            return Err(FileError::at_key(&self.source, ["profile", name], message, Some(help)));
        }
        Ok(servos)
    }

    /// Identified closed-loop models of a profile's joints, in the model's joint order; empty if it has none.
    #[must_use]
    pub fn identified(&self, profile: &ProfileParameters) -> Vec<ClosedLoopModel> {
        self.in_order(&profile.identified)
    }

    /// Value at a path of the robot file, with the values of its groups, defaults and URDF, as TOML.
    pub fn value_of(&self, path: &[&str]) -> Option<toml_edit::Value> {
        let value = with_expanded(&self.source, &self.model, &self.urdf_values, "", |_, expanded, _| {
            Ok(inner(&expanded, path).map(|value| inline_text(value.get_ref())))
        });
        value.ok()??.parse().ok()
    }

    /// Describes the values that neither the file nor the URDF states, and the defaults that take their places.
    #[must_use]
    pub fn defaults(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for (key, default) in [
            ("rotor.encoder_counts_per_turn", "16384"),
            ("friction.static_nm", "coulomb_nm"),
            ("friction.stribeck_rad_per_s", "0.06"),
            ("friction.presliding_rad", "0.001"),
        ] {
            let joints = self.model.joints().iter().map(|joint| joint.name.as_str());
            let lacking: Vec<&str> = joints.filter(|joint| !states(&self.source, joint, key)).collect();
            if !lacking.is_empty() {
                lines.push(format!("{key} = {default} by default: {}", list(lacking.into_iter())));
            }
        }
        let simulated = self.file.simulated.as_ref();
        let mut add = |is_absent: bool, text: &str| lines.extend(is_absent.then(|| text.to_owned()));
        let lacks = |of: fn(&SimulatedParameters) -> bool| simulated.is_some_and(of);
        add(
            lacks(|s| s.bristle.is_none()),
            "simulated.bristle by default: stiffness static_nm/presliding_rad of each joint, damping 5 ms times that, fading over 0.1 rad/s",
        );
        add(
            lacks(|s| s.end_stop.is_none()),
            "simulated.end_stop by default: the torque limit of a joint compresses it by 0.01 rad (m); damping 10 ms times the stiffness",
        );
        add(
            lacks(|s| s.brake.is_none()),
            "simulated.brake by default: slips at 1.5 times the torque limit, after 0.01 rad (m); damping 5 ms times the stiffness",
        );
        lines
    }

    /// Capsules of the links, with which the robot avoids collisions; empty if the robot file has no `[collision]`.
    #[must_use]
    pub fn capsules(&self) -> &[LinkCapsule] {
        self.capsules.as_ref().map_or(&[], |capsules| &capsules.capsules)
    }

    /// Warnings about generated capsules that are in use.
    #[must_use]
    pub fn capsule_warnings(&self) -> &[CapsuleWarning] {
        self.capsules.as_ref().map_or(&[], |capsules| &capsules.warnings)
    }

    /// Gears between motors and links: rigid if the file says so and gives no joint a stiffness.
    #[must_use]
    pub fn gears(&self) -> Gears {
        let is_stated = self.file.joint.values().any(|joint| joint.gear_stiffness_nm_per_rad.is_some());
        if is_stated { Gears::Elastic } else { self.file.interface.gears }
    }

    /// Torque limits of the drives, in the model's joint order (n; Nm or N).
    #[must_use]
    pub fn torque_limits(&self) -> Vec<f64> {
        self.joints().iter().map(|j| j.torque_limit_nm.get()).collect()
    }

    /// Limits of the joints, in the model's joint order: position and velocity from the URDF, the rest from the robot
    /// file.
    #[must_use]
    pub fn joint_limits(&self) -> JointLimits {
        let joints = self.joints();
        let given = |of: fn(&JointParameters) -> Option<Positive>| {
            joints.iter().map(|j| of(j).map_or(f64::INFINITY, Positive::get)).collect()
        };
        JointLimits {
            torque: self.torque_limits(),
            torque_rate: given(|j| j.torque_rate_limit_nm_per_s),
            acceleration: given(|j| j.acceleration_limit_rad_per_s2),
            ..JointLimits::of(&self.model)
        }
    }

    /// Links with capsules of the robot file and those of their meshes that do not exist: they are not needed.
    #[must_use]
    pub fn absent_meshes(&self) -> &[(String, String)] {
        self.capsules.as_ref().map_or(&[], |capsules| &capsules.absent_meshes)
    }

    /// True if the robot file states a value of a joint, for the joint itself or in a group or the defaults.
    pub(crate) fn states(&self, joint: &str, key: &str) -> bool {
        states(&self.source, joint, key)
    }

    fn in_order<T: Clone>(&self, by_name: &BTreeMap<String, T>) -> Vec<T> {
        self.model.joints().iter().filter_map(|j| by_name.get(&j.name).cloned()).collect()
    }
}

/// Parses a URDF; the result includes warnings.
///
/// # Errors
/// Mistakes in the URDF, with the line.
pub fn load_urdf(urdf: &Source, options: UrdfOptions) -> Result<ParsedUrdf, FileError> {
    Model::from_urdf_with(urdf.text(), options).map_err(|error| urdf_error(urdf, &error))
}

/// Expands the document of a robot file, with the values of its URDF and the lines `unknown`, and passes it on, after the
/// document itself.
fn with_expanded<T>(
    source: &Source,
    model: &Model,
    values: &[UrdfValue],
    unknown: &str,
    then: impl FnOnce(&DeTable<'_>, DeTable<'_>, &Groups) -> Result<T, FileError>,
) -> Result<T, FileError> {
    let document = checked(source)?;
    let document = document.get_ref();
    let stated = urdf_layer(values) + &derived_values(document) + unknown;
    let stated = DeTable::parse(&stated)
        .map_err(|error| FileError::of_file(source.name(), error.message().to_owned(), None))?;
    let groups = groups(source, document, model)?;
    let mut expanded = document.clone();
    expand(&mut expanded, stated.get_ref(), &groups, model);
    then(document, expanded, &groups)
}

/// Reads the values of a robot file, of its groups and defaults, and of its URDF.
fn read(
    source: &Source,
    model: &Model,
    dynamics: &[JointDynamics],
    purpose: Purpose,
) -> Result<(RobotFile, Vec<UrdfValue>), FileError> {
    let mut values = urdf_values(model, dynamics);
    let unknown = match purpose {
        Purpose::Control => String::new(),
        Purpose::Identification => no_friction(model, &values),
    };
    let file = with_expanded(source, model, &values, &unknown, |document, expanded, groups| {
        // A misspelt key is reported before the value that it leaves missing.
        check_layers(source, document, &expanded, groups, model)?;
        let deserializer = toml::de::Deserializer::from(Spanned::new(0..0, expanded.clone()));
        let file = RobotFile::deserialize(Strict(deserializer));
        match file {
            Err(error) if !error.message().starts_with("missing field") => {
                Err(explain::<RobotFile>(source, document, &error))
            }
            file => {
                check_complete(source, &expanded, model, purpose)?;
                file.map_err(|error| explain::<RobotFile>(source, document, &error))
            }
        }
    })?;
    // Values that the file states are not those of the URDF.
    values.retain(|value| !states(source, &value.joint, value.key));
    Ok((file, values))
}

/// Returns a document with a friction of zero for joints whose URDF states none.
fn no_friction(model: &Model, values: &[UrdfValue]) -> String {
    let mut text = String::new();
    for joint in model.joints() {
        for key in ["friction.coulomb_nm", "friction.viscous_nms_per_rad"] {
            if !values.iter().any(|value| value.joint == joint.name && value.key == key) {
                let joint = toml_edit::Key::new(&joint.name);
                text += &format!("joint.{joint}.{key} = 0.0\n");
            }
        }
    }
    text
}

/// True if a robot file states a value of a joint, in one of its layers.
fn states(source: &Source, joint: &str, key: &str) -> bool {
    let path: Vec<String> = ["joint", joint].into_iter().chain(key.split('.')).map(str::to_owned).collect();
    let document = DeTable::parse(source.text());
    document.is_ok_and(|document| {
        value_at(document.get_ref(), &path).is_some() || stated_path(document.get_ref(), &path).is_some()
    })
}

/// Writes a value in one line.
fn inline_text(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Table(table) => {
            let keys = table.iter().map(|(key, value)| {
                format!("{} = {}", toml_edit::Key::new(key.get_ref().as_ref()), inline_text(value.get_ref()))
            });
            format!("{{ {} }}", keys.collect::<Vec<_>>().join(", "))
        }
        DeValue::Array(array) => {
            let values: Vec<String> = array.iter().map(|value| inline_text(value.get_ref())).collect();
            format!("[{}]", values.join(", "))
        }
        DeValue::String(text) => toml_edit::Value::from(text.as_ref()).to_string(),
        DeValue::Integer(number) => number.to_string(),
        DeValue::Float(number) => number.to_string(),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Datetime(time) => time.to_string(),
    }
}

/// Smallest rate of the plant that is chosen for a robot that states none, Hz.
const LEAST_PHYSICS_HZ: f64 = 10_000.0;

/// Returns a document of values that follow from others: the default profile, the setpoints of a torque robot, and the rate
/// of the plant.
fn derived_values(document: &DeTable<'_>) -> String {
    let mut text = String::new();
    let profiles = inner(document, &["profile"]).and_then(|profiles| profiles.get_ref().as_table());
    let names: Vec<String> =
        profiles.iter().flat_map(|p| p.keys()).map(|name| name.get_ref().to_string()).collect();
    if let [only] = names.as_slice() {
        text += &format!("default_profile = {}\n", toml_edit::Value::from(only.as_str()));
    }
    let command = inner(document, &["interface", "command"]).and_then(|command| command.get_ref().as_str());
    if command == Some("torque") {
        text += "interface.setpoints = \"held\"\n";
    }
    let rate = |name: &String| match inner(document, &["profile", name, "servo_hz"])?.get_ref() {
        DeValue::Float(number) => number.as_str().replace('_', "").parse::<f64>().ok(),
        DeValue::Integer(number) => number.as_str().replace('_', "").parse::<f64>().ok(),
        _ => None,
    };
    let rates: Option<Vec<f64>> = names.iter().map(rate).collect();
    if let Some(rates) = rates {
        let fastest = rates.iter().copied().fold(0.0, f64::max);
        let multiples = (1..=1000).map(|times| f64::from(times) * fastest);
        let is_multiple = |hz: &f64| rates.iter().all(|rate| (hz / rate).fract() == 0.0);
        let found = multiples.skip_while(|hz| *hz < LEAST_PHYSICS_HZ).find(is_multiple);
        text += &found.map_or_else(String::new, |hz| format!("simulated.physics_hz = {hz:?}\n"));
    }
    text
}

/// Checks that the keys that are marked as assumed exist.
fn check_assumed(source: &Source, assumed: &[String]) -> Result<(), FileError> {
    let document = checked(source)?;
    for (index, key) in assumed.iter().enumerate() {
        let path = key.segments();
        let depth = depth_of(document.get_ref(), &path);
        if depth == path.len() && !path.is_empty() {
            continue;
        }
        let present = keys_at(document.get_ref(), &path[..depth]);
        let missing = path.get(depth).map_or("", String::as_str);
        let within = if depth == 0 { "the file".to_owned() } else { format!("`{}`", dotted(&path[..depth])) };
        let message = format!("`{key}` is marked as assumed, but {within} has no key `{missing}`");
        let help = format!("{}; remove entries whose values are known", choices(missing, &present));
        return Err(FileError::at_key(source, ["assumed", &index.to_string()], message, Some(help)));
    }
    Ok(())
}

fn check_rate(source: &Source, name: &str, profile: &ProfileParameters) -> Result<(), FileError> {
    let rate_hz = profile.servo_hz.get();
    if SERVO_RATES_HZ.contains(&rate_hz) {
        return Ok(());
    }
    let (low, high) = (SERVO_RATES_HZ.start(), SERVO_RATES_HZ.end());
    let message = format!("a servo rate of {rate_hz:e} Hz is not from {low:e} to {high:e} Hz");
    let help = if rate_hz > *high {
        "give the rate of the position or velocity servo, not that of its current loop: checks and simulations compute each \
         of its periods"
    } else {
        "give it in hertz"
    };
    Err(FileError::at_key(source, ["profile", name, "servo_hz"], message, Some(help.to_owned())))
}

/// Checks that a profile has a position servo for every joint, a velocity servo for every joint, or both.
fn check_servos(
    source: &Source,
    model: &Model,
    name: &str,
    profile: &ProfileParameters,
) -> Result<(), FileError> {
    if !profile.velocity_servo.is_empty() {
        joints_of(source, model, &profile.velocity_servo, &["profile", name, "velocity_servo"])?;
    }
    if !profile.servo.is_empty() {
        joints_of(source, model, &profile.servo, &["profile", name, "servo"])?;
    }
    for (joint, servo) in &profile.servo {
        let wrong = |message, help| {
            FileError::at_key(source, ["profile", name, "servo", joint.as_str()], message, help)
        };
        if servo.takes() == CommandKind::Velocity {
            let message = format!(
                "the servo of joint '{joint}' is a velocity servo, but this table is for position servos"
            );
            return Err(wrong(message, Some(format!("move it to [profile.{name}.velocity_servo.{joint}]"))));
        }
        ServoLaw::new(servo, profile.servo_period_s()).map_err(|error| wrong(error.to_string(), None))?;
    }
    for (joint, servo) in &profile.velocity_servo {
        ServoLaw::new(&ServoParameters::Velocity(*servo), profile.servo_period_s()).map_err(|error| {
            let key = ["profile", name, "velocity_servo", joint.as_str()];
            FileError::at_key(source, key, error.to_string(), None)
        })?;
    }
    Ok(())
}

/// Checks that the setpoint limits of a profile are those of joints of the model.
fn check_setpoint_limits(
    source: &Source,
    model: &Model,
    name: &str,
    profile: &ProfileParameters,
) -> Result<(), FileError> {
    let joints = profile.setpoint_limits.iter().flat_map(|limits| limits.joint.keys());
    for joint in joints {
        if let Err(unknown) = model.joint(joint) {
            let key = ["profile", name, "setpoint_limits", "joint", joint.as_str()];
            let message = format!("the URDF has no moving joint '{joint}'");
            return Err(FileError::at_key(source, key, message, Some(choices(joint, &unknown.known))));
        }
    }
    Ok(())
}

/// Maximum number of servo ticks per interface cycle; a larger number indicates a mistake in a rate.
const MAX_RATIO: u32 = 10_000;

/// Maximum inertia of a rotor reflected to its joint, kg m² (kg): that of a URDF's moments.
const MAX_REFLECTED_INERTIA: f64 = 1e9;

/// Maximum rest period before a start, s; a longer one indicates a mistake in a unit.
const MAX_TARE_S: f64 = 60.0;

/// Checks values that depend on each other.
fn check_values(source: &Source, file: &RobotFile, model: &Model) -> Result<(), FileError> {
    if !file.interface.measured.contains(&Measured::Position) {
        let message = "a robot that does not measure its joint positions cannot be controlled";
        let help = Some(
            "write measured = [\"position\"], and add \"motor-current\" if the robot measures it".to_owned(),
        );
        return Err(FileError::at_key(source, "interface.measured", message, help));
    }
    if file.safety.tare_s.get() > MAX_TARE_S {
        let message = format!("tare_s is above {MAX_TARE_S} s");
        return Err(FileError::at_key(
            source,
            "safety.tare_s",
            message,
            Some("give it in seconds".to_owned()),
        ));
    }
    for (name, profile) in &file.profile {
        if profile.servo_ticks_per_cycle.get() > MAX_RATIO {
            let message = format!("more than {MAX_RATIO} servo ticks per interface cycle");
            return Err(FileError::at_key(source, ["profile", name, "servo_ticks_per_cycle"], message, None));
        }
    }
    let detection = file.collision_detection.as_ref();
    for joint in model.joints() {
        let name = joint.name.as_str();
        if let Some(CollisionReaction::Retract(parameters)) = detection.map(|detection| detection.reaction)
            && parameters.top_speed() > joint.limits.velocity
        {
            let (speed, limit) = (parameters.top_speed(), joint.limits.velocity);
            let message = format!(
                "the retraction moves at up to 1.875 distance_rad/duration_s = {speed} rad/s (m/s); joint '{name}' at most at {limit}"
            );
            let help = Some("give a smaller distance_rad, or a larger duration_s".to_owned());
            return Err(FileError::at_key(source, "collision_detection.reaction", message, help));
        }
        let friction = file.joint.get(name).map(|j| &j.friction);
        let reflected = file.joint.get(name).map_or(0.0, |j| j.rotor.reflected_inertia());
        // Infinite if the square of the ratio overflows, NaN if its product with zero does.
        if reflected.is_nan() || reflected > MAX_REFLECTED_INERTIA {
            let message = format!("the rotor's inertia times gear_ratio² is {reflected:e} kg m²");
            let help = Some(format!("give values whose product is at most {MAX_REFLECTED_INERTIA:e}"));
            return Err(FileError::at_key(source, ["joint", name, "rotor"], message, help));
        }
        if friction.is_some_and(|f| f.static_nm < f.coulomb_nm) {
            let key = ["joint", name, "friction", "static_nm"];
            let message = "static friction must not be below Coulomb friction";
            return Err(FileError::at_key(source, key, message, Some("give at least coulomb_nm".to_owned())));
        }
    }
    Ok(())
}

/// Returns the values of a map by joint name, in the model's joint order. Checks that its keys are exactly the joints
/// of the model.
fn joints_of<'a, T>(
    source: &Source,
    model: &Model,
    map: &'a BTreeMap<String, T>,
    table: &[&str],
) -> Result<Vec<&'a T>, FileError> {
    let names = || model.joints().iter().map(|j| j.name.as_str());
    if let Some(unknown) = map.keys().find(|name| model.joint(name).is_err()) {
        let key: Vec<&str> = table.iter().copied().chain([unknown.as_str()]).collect();
        let message = format!("the URDF has no moving joint '{unknown}'");
        return Err(FileError::at_key(source, key, message, Some(choices(unknown, names()))));
    }
    let mut values = Vec::new();
    for name in names() {
        let Some(value) = map.get(name) else {
            let message = format!("joint '{name}' of the URDF is missing in `{}`", table.join("."));
            let help = format!(
                "add [{}.{name}]; each of these joints needs one: {}",
                table.join("."),
                list(names())
            );
            return Err(FileError::at_key(source, table.to_vec(), message, Some(help)));
        };
        values.push(value);
    }
    Ok(values)
}

/// Sets the loads of force sensors that a robot file does not state: those of what is beyond them, also of the simulated ones.
/// Returns the links and tools beyond sensors whose load does not follow.
fn set_loads(
    files: (&Source, &Source),
    (model, link_inertias): (&Model, &[Inertia]),
    file: &mut RobotFile,
) -> Result<BTreeMap<String, Vec<String>>, FileError> {
    let sensors = file.force_sensor.iter();
    let sensors = sensors.map(|(name, sensor)| Sensor { name, frame: &sensor.frame, stated: sensor.load });
    let loads = sensor_loads(files, (model, link_inertias), &file.tool, &sensors.collect::<Vec<_>>())?;
    for (name, load) in loads.known {
        if let Some(simulated) = &mut file.simulated
            && let Some(sensor) = simulated.force_sensor.get_mut(&name)
            && let Ok(mass_kg) =
                Positive::try_from(load.mass_kg.get() * simulated.true_over_nominal.inertia.get())
        {
            sensor.load.get_or_insert(TrueLoad { mass_kg, centre_m: load.centre_m });
        }
        if let Some(sensor) = file.force_sensor.get_mut(&name) {
            sensor.load.get_or_insert(load);
        }
    }
    Ok(loads.unknown)
}

fn estimated_forces(
    source: &Source,
    model: &Model,
    file: &RobotFile,
) -> Result<Vec<(String, FrameId)>, FileError> {
    let mut found = Vec::new();
    for (name, estimated) in &file.estimated_force {
        if file.force_sensor.contains_key(name) {
            let message = format!("'{name}' is also the name of a force sensor");
            let help = Some("give one of the two another name".to_owned());
            return Err(FileError::at_key(source, ["estimated_force", name.as_str()], message, help));
        }
        let frame = sensor_frame(source, model, ["estimated_force", name, "frame"], &estimated.frame)?;
        found.push((name.clone(), frame));
    }
    Ok(found)
}

/// Frame of a force sensor, with its key in the file.
fn sensor_frame(source: &Source, model: &Model, key: [&str; 3], frame: &str) -> Result<FrameId, FileError> {
    model.frame_id(frame).map_err(|unknown| {
        let help = choices(&unknown.name, &unknown.known);
        let message = format!("the robot has no frame '{0}': the URDF has no link '{0}'", unknown.name);
        FileError::at_key(source, key, message, Some(help))
    })
}

fn force_sensors(
    source: &Source,
    model: &Model,
    sensors: &BTreeMap<String, ForceSensorFile>,
) -> Result<Vec<(String, FrameId)>, FileError> {
    let mut found = Vec::new();
    for (name, sensor) in sensors {
        let frame = sensor_frame(source, model, ["force_sensor", name, "frame"], &sensor.frame)?;
        found.push((name.clone(), frame));
    }
    Ok(found)
}
