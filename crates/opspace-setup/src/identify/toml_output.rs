//! Identification results in the format of robot.toml: the servo section, and a complete file.

use super::{IdentificationResults, JointIdentification, Method};
use opspace_experiment::files::source::{FileError, KeyPath};
use opspace_experiment::transformers::gain_interval::ASSUMED;
use opspace_identify::identification::Servo;
use opspace_identify::interval::SetpointFilterModel;
use opspace_identify::static_identification::StaticServo;
use opspace_identify::{Interval95, TorqueScale};
use opspace_transformer::IdentifiedGains;
use std::fmt::Write as _;
use std::path::Path;
use toml_edit::{Array, DocumentMut, InlineTable, Item, Table, Value};

impl IdentificationResults {
    /// Identified keys, to be copied into robot.toml. For joints that cannot be driven by torques, comments give the
    /// reason and the values that are known.
    #[must_use]
    pub fn servo_toml(&self) -> String {
        let profile = &self.profile_name;
        let mut text = format!(
            "# Servos of {}, profile {profile}, identified by `opspace identify`: keys for its robot.toml.\n",
            self.robot.name()
        );
        if self.joints.iter().any(|j| j.no_torque_mode.is_some()) {
            text += "# Torque mode is refused for some joints; the comments name them and the reasons.\n";
        }
        let usable = || self.joints.iter().filter(|j| j.no_torque_mode.is_none());
        if let Some((delay, all)) = self.delay().filter(|_| usable().next().is_some()) {
            let doubt = if all { "" } else { " # of most joints; the other joints have another delay" };
            // Writing to a String cannot fail.
            let _ = writeln!(text, "\n[profile.{profile}]\ndelay_servo_ticks = {delay}{doubt}");
        }
        let _ = writeln!(text, "\n[profile.{profile}.servo]");
        for joint in &self.joints {
            text += &match &joint.no_torque_mode {
                None => {
                    format!("# {}\n{}{} = {}\n", remark(joint), doubts(joint), joint.name, self.servo(joint))
                }
                Some(reason) => format!("# {}: {reason}.\n{}", joint.name, ratios(joint)),
            };
        }
        for joint in usable() {
            if let Some(identified) = identified(joint) {
                let _ = writeln!(
                    text,
                    "\n[profile.{profile}.identified.{}]\n{}",
                    joint.name,
                    identified.to_string().trim_end()
                );
            }
        }
        for joint in usable() {
            if let Some(friction) = self.friction(joint) {
                let _ = writeln!(text, "\n[joint.{}]\nfriction = {friction}", joint.name);
            }
        }
        text
    }

    /// Returns the complete robot file with identified values in place of the nominal ones, for a URDF with the file
    /// name `urdf` in the same folder. The simulated plant does not change: the previous nominal values are written
    /// to `[simulated]`. `None` if any joint cannot be driven by torques.
    ///
    /// # Errors
    /// If the robot file cannot be edited; this does not occur if it was read without error.
    pub fn robot_toml(&self, urdf: &str) -> Result<Option<String>, FileError> {
        if !self.is_complete() {
            return Ok(None);
        }
        let wrong = |what: &str| FileError::of_file(self.robot.source.name(), what.to_owned(), None);
        let mut document: DocumentMut =
            self.robot.source.text().parse().map_err(|e| wrong(&format!("not TOML: {e}")))?;
        let profile = self.profile_name.as_str();
        let file = document.as_table_mut();
        put(file, "urdf", urdf.into());
        put(file, "default_profile", profile.into());
        self.keep_plant(file).ok_or_else(|| wrong("its tables cannot be edited"))?;
        let profiles = table(file, "profile").ok_or_else(|| wrong("`profile` is not a table"))?;
        profiles.retain(|name, _| name == profile);
        let driven = table(profiles, profile).ok_or_else(|| wrong("its profile is not a table"))?;
        if let Some((delay, _)) = self.delay() {
            put(driven, "delay_servo_ticks", i64::from(delay).into());
        }
        let servos = table_or_new(driven, "servo").ok_or_else(|| wrong("`servo` is not a table"))?;
        for joint in &self.joints {
            put(servos, &joint.name, self.servo(joint));
        }
        // All joints or none, because a transformer needs the models of all joints.
        let measured: Option<Vec<Table>> = self.joints.iter().map(identified).collect();
        if let Some(measured) = measured.filter(|measured| measured.len() == self.robot.model.n()) {
            let mut joints = Table::new();
            joints.set_implicit(true);
            for (joint, measured) in self.joints.iter().zip(measured) {
                joints.insert(&joint.name, Item::Table(measured));
            }
            driven.insert("identified", Item::Table(joints));
        }
        // Values of a joint may all be those of a group, of all joints, or of the URDF.
        let joints = table_or_new(file, "joint").ok_or_else(|| wrong("`joint` is not a table"))?;
        for joint in &self.joints {
            if let Some(friction) = self.friction(joint) {
                let drive =
                    table_or_new(joints, &joint.name).ok_or_else(|| wrong("a joint is not a table"))?;
                put(drive, "friction", friction);
            }
        }
        self.keep_assumed(file);
        let head = format!(
            "# Identified by `opspace identify`: {}. The plant of the simulation is the identified one.\n",
            self.joints.iter().map(|j| j.name.as_str()).collect::<Vec<_>>().join(", ")
        );
        Ok(Some(head + &without_schema(&document.to_string())))
    }

    /// Removes the keys of values that are no longer assumed or no longer in the file from `assumed`.
    fn keep_assumed(&self, file: &mut Table) {
        let Some(assumed) = file.get_mut("assumed").and_then(Item::as_array_mut) else { return };
        assumed.retain(|key| {
            let path = key.as_str().unwrap_or_default().segments();
            match path.iter().map(String::as_str).collect::<Vec<&str>>().as_slice() {
                ["profile", profile, ..] => *profile == self.profile_name,
                ["joint", name, "friction", ..] => {
                    let identified = self.joints.iter().find(|joint| joint.name == *name);
                    identified.is_none_or(|joint| self.friction(joint).is_none())
                }
                _ => true,
            }
        });
    }

    /// File name of the copy of the URDF.
    #[must_use]
    pub fn urdf_name(&self) -> String {
        let name = Path::new(self.robot.urdf.name()).file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// Text of the URDF.
    #[must_use]
    pub fn urdf(&self) -> &str {
        self.robot.urdf.text()
    }

    /// Identified friction of a joint; its presliding displacement is that of the robot's file.
    fn friction(&self, joint: &JointIdentification) -> Option<Value> {
        if let Some(servo) = &joint.found.static_servo {
            return self.static_friction(joint, servo);
        }
        let servo = joint.found.servo.as_ref()?;
        // Friction that the motion does not separate is not written.
        let friction = servo.friction.filter(|_| servo.intervals.coulomb.is_some())?;
        let presliding = self.robot.file.joint.get(&joint.name)?.friction.presliding_rad;
        let mut values = InlineTable::new();
        values.insert("coulomb_nm", rounded(friction.coulomb));
        values.insert("static_nm", rounded(friction.static_friction));
        values.insert("stribeck_rad_per_s", rounded(friction.stribeck));
        values.insert("viscous_nms_per_rad", rounded(friction.viscous));
        values.insert("presliding_rad", presliding.get().into());
        Some(values.into())
    }

    /// Friction of a joint that was identified statically. The sweeps do not show the Stribeck effect: static over Coulomb friction
    /// remains as declared.
    fn static_friction(&self, joint: &JointIdentification, servo: &StaticServo) -> Option<Value> {
        let declared = &self.robot.file.joint.get(&joint.name)?.friction;
        let coulomb = servo.coulomb.max(0.0);
        let ratio = match declared.coulomb_nm.get() {
            0.0 => 1.0,
            nominal => declared.static_nm.get() / nominal,
        };
        let mut values = InlineTable::new();
        values.insert("coulomb_nm", rounded(coulomb));
        values.insert("static_nm", rounded(coulomb * ratio));
        values.insert("stribeck_rad_per_s", declared.stribeck_rad_per_s.get().into());
        values.insert("viscous_nms_per_rad", rounded(servo.viscous.max(0.0)));
        values.insert("presliding_rad", declared.presliding_rad.get().into());
        Some(values.into())
    }

    /// Writes the previous nominal values to `[simulated]`, except for values that it already contains.
    fn keep_plant(&self, file: &mut Table) -> Option<()> {
        let mut servos = Vec::new();
        let mut frictions = Vec::new();
        for joint in &self.joints {
            let value = |path: &[&str]| self.robot.value_of(path)?.as_inline_table().cloned();
            // A file to identify may lack both; the plant then states its own.
            let servo = value(&["profile", &self.profile_name, "servo", &joint.name]);
            servos.extend(servo.map(|servo| (joint.name.clone(), servo)));
            let friction = value(&["joint", &joint.name, "friction"]);
            frictions.extend(friction.map(|friction| (joint.name.clone(), friction)));
        }
        let simulated = table(file, "simulated")?;
        let delay = i64::from(self.profile.delay());
        simulated.entry("delay_servo_ticks").or_insert(Item::Value(delay.into()));
        for (key, values) in [("servo", servos), ("friction", frictions)] {
            let known = simulated.entry(key).or_insert(Item::Table(Table::new()));
            for (name, value) in values {
                known.as_table_like_mut()?.entry(&name).or_insert(Item::Value(value.into()));
            }
        }
        Some(())
    }
}

/// Returns an inner table; an inline table is first converted to a standard table.
fn table<'a>(parent: &'a mut Table, key: &str) -> Option<&'a mut Table> {
    let item = parent.get_mut(key)?;
    if item.is_inline_table() {
        let inner = std::mem::take(item);
        *item = Item::Table(inner.into_table().ok()?);
    }
    item.as_table_mut()
}

/// Returns an inner table, which is made if it does not exist.
fn table_or_new<'a>(parent: &'a mut Table, key: &str) -> Option<&'a mut Table> {
    if !parent.contains_key(key) {
        let mut new = Table::new();
        new.set_implicit(true);
        parent.insert(key, Item::Table(new));
    }
    table(parent, key)
}

/// Replaces a value and drops its comment, which described the old value.
fn put(table: &mut Table, key: &str, value: Value) {
    table.insert(key, Item::Value(value));
}

/// Removes the `#:schema` line for editors, because there is no schema in the new folder.
fn without_schema(text: &str) -> String {
    text.lines().filter(|line| !line.starts_with("#:schema")).map(|line| line.to_owned() + "\n").collect()
}

/// Doubts about a joint, as comments.
fn doubts(joint: &JointIdentification) -> String {
    joint.found.doubts.iter().map(|doubt| format!("# doubtful: {doubt}\n")).collect()
}

/// Source of a servo's torque scale, and its fit quality.
fn remark(joint: &JointIdentification) -> String {
    let scale = match joint.found.scale {
        TorqueScale::MotorCurrent => "motor current",
        TorqueScale::Urdf => "URDF and rotor inertia, kp and kv with the declared viscous friction",
        TorqueScale::Gravity => return static_remark(joint),
        TorqueScale::Unknown => "nothing",
    };
    let trust = joint.found.fit_quality.as_ref().map_or_else(String::new, |t| {
        format!(
            "; bandwidth {:.0} Hz, error of T {:.1} %{}",
            t.bandwidth_hz,
            100.0 * t.position_residual,
            t.torque_residual.map_or_else(String::new, |r| format!(", of torque {:.1} %", 100.0 * r))
        )
    });
    let within = |interval: Option<Interval95>| {
        interval.map_or_else(|| "?".to_owned(), |i| format!("{} to {}", rounded(i.lower), rounded(i.upper)))
    };
    let intervals = joint.found.servo.as_ref().map_or_else(String::new, |servo| {
        let all = &servo.intervals;
        format!(
            "; 95 %: kp {}, kv {}, Coulomb {}, viscous {}",
            within(all.kp),
            within(all.kv),
            within(all.coulomb),
            within(all.viscous)
        )
    });
    format!("torque scale from {scale}{trust}{intervals}")
}

/// Source of the stiffness of a servo without a velocity loop, and the intervals.
fn static_remark(joint: &JointIdentification) -> String {
    let Some(servo) = &joint.found.static_servo else { return String::new() };
    let source = match (servo.stiffness_from, servo.hung_weight) {
        (Some(_), _) => "another joint with the same declared gains",
        (None, Some(hung)) if hung.stiffness == servo.stiffness => "the hung weight",
        (None, Some(_)) => "gravity with the masses of the URDF, which a hung weight confirms",
        (None, None) => "gravity with the masses of the URDF",
    };
    let within = |i: Interval95| format!("{} to {}", rounded(i.lower), rounded(i.upper));
    format!(
        "stiffness from {source}; 95 %: {}, Coulomb {}, viscous {}; the other keys are as declared",
        within(servo.stiffness_interval),
        within(servo.coulomb_interval),
        within(servo.viscous_interval)
    )
}

impl IdentificationResults {
    /// Servo of a joint in the format of robot.toml.
    fn servo(&self, joint: &JointIdentification) -> Value {
        let Some(found) = &joint.found.static_servo else { return servo(joint) };
        let path = ["profile", &self.profile_name, "servo", &joint.name];
        let declared = self.robot.value_of(&path).and_then(|value| value.as_inline_table().cloned());
        let mut kind = declared.unwrap_or_default();
        if let Some(values) = kind.get_mut(joint.structure.name).and_then(Value::as_inline_table_mut) {
            values.insert("stiffness_nm_per_rad", rounded(found.stiffness));
            let relative = found.stiffness_interval.half_width() / found.stiffness;
            values.insert("gain_uncertainty", thousandths(relative).into());
            values.fmt();
        }
        kind.fmt();
        kind.into()
    }
}

/// Rounds a fraction up to thousandths, from one thousandth to one.
fn thousandths(fraction: f64) -> f64 {
    (1e3 * fraction).ceil().clamp(1.0, 1e3) / 1e3
}

fn servo(joint: &JointIdentification) -> Value {
    let (mut kind, mut values) = (InlineTable::new(), InlineTable::new());
    if let (Some(servo), Method::Multisines(keys)) = (&joint.found.servo, joint.structure.method) {
        let gains = IdentifiedGains {
            kp_per_s: servo.kp,
            kv_nms_per_rad: servo.kv,
            filter_hz: servo.velocity_filter_hz,
        };
        for (key, value) in keys(&gains) {
            values.insert(key, rounded(value));
        }
        add_setpoint_path(&mut values, servo);
        values.insert("gain_uncertainty", gain_uncertainty(servo, joint.structure.name).into());
        kind.insert(joint.structure.name, values.into());
    }
    kind.into()
}

/// Half-width of the interval of the gains, as a fraction of them, in thousandths. For a cascade it is that of kp, because kv only
/// scales the torque. For other servos, stiffness over damping is kp at the ends of both intervals. Gains without an interval are as
/// uncertain as assumed ones.
fn gain_uncertainty(servo: &Servo, structure: &str) -> f64 {
    let Servo { kp, .. } = *servo;
    let half_width = servo.intervals.kp.map_or(ASSUMED, |i| (i.upper - kp).max(kp - i.lower) / kp);
    let of_each = if structure == "cascaded" { half_width } else { half_width / (2.0 + half_width) };
    thousandths(of_each)
}

/// Adds feed-forward and filter of the setpoint.
fn add_setpoint_path(values: &mut InlineTable, servo: &Servo) {
    if servo.velocity_feed_forward > 0.0 {
        values.insert("velocity_feed_forward", rounded(servo.velocity_feed_forward.min(1.0)));
    }
    let (kind, keys): (&str, &[(&str, f64)]) = match servo.setpoint_filter {
        SetpointFilterModel::None => return,
        SetpointFilterModel::FirstOrder { cutoff_hz } => ("first-order", &[("cutoff_hz", cutoff_hz)]),
        SetpointFilterModel::SecondOrder { natural_frequency_hz, damping_ratio } => (
            "second-order",
            &[("natural_frequency_hz", natural_frequency_hz), ("damping_ratio", damping_ratio)],
        ),
    };
    let (mut filter, mut parameters) = (InlineTable::new(), InlineTable::new());
    keys.iter().for_each(|(key, value)| drop(parameters.insert(*key, rounded(*value))));
    filter.insert(kind, parameters.into());
    values.insert("setpoint_filter", filter.into());
}

/// Identified ratios of a servo whose torque scale is unknown; empty for other servos.
fn ratios(joint: &JointIdentification) -> String {
    let Some(servo) = joint.found.servo.as_ref().filter(|_| joint.found.scale == TorqueScale::Unknown) else {
        return String::new();
    };
    let coulomb = servo.friction.map_or_else(String::new, |f| {
        format!(", Coulomb friction over inertia {} rad/s2", rounded(f.coulomb))
    });
    format!(
        "#   kp {} 1/s, kv over inertia {} 1/s, filter {} Hz, delay {} servo ticks{coulomb}\n",
        rounded(servo.kp),
        rounded(servo.kv),
        rounded(servo.velocity_filter_hz),
        servo.delay
    )
}

/// Parameters of the `identified` transformers: the fitted T without hold and delay, and the ideal joint G* of equation
/// (K5). T is scaled to T(0) = 1, because a joint without load moves to its setpoint.
fn identified(joint: &JointIdentification) -> Option<Table> {
    let (servo, t) = (joint.found.servo.as_ref()?, joint.found.rational.as_ref()?);
    let trusted_hz = joint.found.fit_quality.as_ref()?.bandwidth_hz;
    let from_hz = joint.found.measured.first()?.position.first()?.hz;
    // Only linear friction, as in equation (K5): the contribution of Coulomb friction to T at one amplitude is not
    // part of the servo.
    let viscous = servo.friction.map_or(0.0, |friction| friction.viscous);
    let static_gain = t.rational.numerator.first()? / t.rational.denominator.first()?;
    let polynomials = |numerator: &[f64], denominator: &[f64]| {
        let list = |p: &[f64]| p.iter().copied().collect::<Array>();
        let mut rational = InlineTable::new();
        rational.insert("numerator", list(numerator).into());
        rational.insert("denominator", list(denominator).into());
        Item::Value(rational.into())
    };
    let numerator: Vec<f64> = t.rational.numerator.iter().map(|b| b / static_gain).collect();
    let mut table = Table::new();
    table.insert("closed_loop", polynomials(&numerator, &t.rational.denominator));
    table.insert("open_loop", polynomials(&[1.0], &[0.0, viscous, servo.inertia]));
    table.insert("from_hz", Item::Value(rounded(from_hz)));
    table.insert("to_hz", Item::Value(rounded(trusted_hz)));
    Some(table)
}

/// Rounds to four significant digits, which is the accuracy of the measurement.
fn rounded(value: f64) -> Value {
    if value == 0.0 || !value.is_finite() {
        return 0.0.into();
    }
    let digits = 10f64.powi(3 - value.abs().log10().floor() as i32);
    Value::from((value * digits).round() / digits)
}
