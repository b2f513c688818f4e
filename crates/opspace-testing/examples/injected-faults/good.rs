//! Good tasks: an arm, a task that it can do, and the text of the task file.

use crate::arms::{ARMS, Arm, Posture};
use nalgebra::Vector3;
use opspace_experiment::{
    ControllerKind, Experiment, FileError, Progress, RunOptions, Source, TaskDefinition,
};
use opspace_log::Recording;
use opspace_preflight::diagnostics;
use opspace_preflight::gain_margin;
use rand::{Rng, RngExt};
use std::io::Cursor;
use std::path::Path;
use std::process::Command;

/// Kind of a good task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Base {
    /// The hand moves to a goal.
    Reach,
    /// The hand follows sinusoids.
    Track,
    /// The joints move to a goal.
    Joints,
    /// The hand presses on a wall.
    Press,
    /// The hand holds a load that the model does not know.
    Carry,
    /// The hand is compliant along an axis, and held by an operator.
    Led,
    /// The hand yields to pushes as a spring.
    Yield,
}

const BASES: [Base; 7] =
    [Base::Reach, Base::Track, Base::Joints, Base::Press, Base::Carry, Base::Led, Base::Yield];

/// Drawn task, of which faults change parts.
pub struct Drawn {
    pub base: Base,
    pub arm: &'static Arm,
    pub settings: Vec<String>,
    pub start: Vec<f64>,
    pub frequency_rad_per_s: f64,
    /// Mode of each axis.
    pub axes: Vec<(&'static str, &'static str)>,
    /// Reference of the task, in TOML.
    pub reference: String,
    /// Impedance in place of gains, in TOML.
    impedance: Option<String>,
    pub force: Option<Force>,
    /// Mass of a load on the hand, kg.
    pub load_kg: Option<f64>,
    pub wall: Option<Wall>,
    pub controller: ControllerKind,
    /// Other tables of the task file.
    pub tables: String,
    seed: u64,
}

/// Target of a force axis.
pub struct Force {
    pub axis: &'static str,
    pub target_n: f64,
    pub approach_m_per_s: Option<f64>,
}

/// Wall in front of the hand.
pub struct Wall {
    pub point: Vector3<f64>,
    pub normal: Vector3<f64>,
    pub stiffness_n_per_m: f64,
}

/// Duration of a task, s.
pub const DURATION_S: f64 = 3.0;

/// Largest error of the gains of the position loops of a good robot, as a fraction of them.
const GAIN_ERROR: f64 = 0.1;

/// Time from which the errors of a task count, s.
const SETTLE_S: f64 = 1.5;

/// One of several values.
pub fn one_of<T: Copy>(random: &mut impl Rng, of: &[T]) -> T {
    of[random.random_range(0..of.len())]
}

/// Unit vector of an axis of translation.
pub fn direction(axis: &str) -> Vector3<f64> {
    let place = ["x", "y", "z"].iter().position(|name| *name == axis).expect("an axis of translation");
    Vector3::ith(place, 1.0)
}

impl Drawn {
    /// Draws a task of a kind, or of any.
    pub fn new(base: Option<Base>, random: &mut impl Rng) -> Self {
        let base = base.unwrap_or_else(|| one_of(random, &BASES));
        let arm = &ARMS[random.random_range(0..ARMS.len())];
        let start: Vec<f64> = arm.usual.iter().map(|q| q + random.random_range(-0.2..0.2)).collect();
        let mut drawn = Self {
            base,
            arm,
            settings: Vec::new(),
            start,
            frequency_rad_per_s: random.random_range(10.0..22.0),
            axes: arm.axes.iter().map(|axis| (*axis, "motion")).collect(),
            reference: "reference = \"hold\"".to_owned(),
            impedance: None,
            force: None,
            load_kg: None,
            wall: None,
            controller: ControllerKind::Osc,
            tables: String::new(),
            seed: random.random_range(1..1_000_000),
        };
        drawn.draw_robot(random);
        let posture = Posture::new(arm, &drawn.settings, &drawn.start);
        match base {
            Base::Reach => drawn.reach(random),
            Base::Track => drawn.track(random),
            Base::Joints => drawn.move_joints(random),
            Base::Press => drawn.press(&posture, random),
            Base::Carry => drawn.carry(&posture, random),
            Base::Led => drawn.lead(random),
            Base::Yield => drawn.give_way(random),
        }
        drawn
    }

    /// Draws what differs from one robot to another: a tool, encoders, and a sensor.
    fn draw_robot(&mut self, random: &mut impl Rng) {
        if random.random() {
            let most_kg = 0.1 * Posture::new(self.arm, &[], &self.start).largest_mass_kg();
            let mass_kg = random.random_range(0.2..1.0) * most_kg;
            self.settings.push(tool(self.arm, mass_kg));
        }
        if self.arm.name != "asimo-arm" {
            self.settings.push(format!("robot.force_sensor.tip={{ frame = \"{}\" }}", self.arm.frame));
            self.settings.push(
                "robot.simulated.force_sensor.tip={ bandwidth_hz = 100.0, noise_n = 0.1, noise_nm = 0.01, bias_n = 0.0, bias_nm = 0.0 }"
                    .to_owned(),
            );
        }
        if random.random() {
            self.settings.push("robot.interface.measured=[\"position\"]".to_owned());
            // Without motor current the default transformer leaves damping for gains that are not known exactly.
            let profile = self.arm.robot(&[]).file.default_profile;
            for joint in self.joints() {
                let key = format!("robot.profile.{profile}.servo.{joint}.cascaded.gain_uncertainty");
                self.settings.push(format!("{key}={:?}", GAIN_ERROR));
            }
            self.settings.push("robot.estimated_force={}".to_owned());
        }
    }

    fn sensor(&self) -> &'static str {
        if self.arm.name == "asimo-arm" { "wrist" } else { "tip" }
    }

    /// Axes of translation of the task.
    pub fn translations(&self) -> Vec<&'static str> {
        self.arm.axes.iter().copied().filter(|axis| axis.len() == 1).collect()
    }

    /// Displacement of the hand, m.
    pub fn offset(&self, random: &mut impl Rng) -> [f64; 3] {
        let axes = self.translations();
        ["x", "y", "z"].map(|axis| {
            let drawn = self.arm.size_m * random.random_range(-1.0_f64..1.0);
            if axes.contains(&axis) { drawn } else { 0.0 }
        })
    }

    fn reach(&mut self, random: &mut impl Rng) {
        let offset = self.offset(random);
        let duration_s: f64 = random.random_range(1.0..2.0);
        self.reference = format!(
            "reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = {duration_s:?} }}"
        );
    }

    fn track(&mut self, random: &mut impl Rng) {
        self.reference = "[task.hand.cartesian.reference.sinusoid]\nramp_s = 1.0".to_owned();
        for axis in self.translations() {
            let amplitude_m = 0.5 * self.arm.size_m * random.random_range(0.2..1.0);
            let hz = random.random_range(0.2..0.6);
            self.reference +=
                &format!("\n{axis} = [{{ amplitude_m = {amplitude_m:?}, frequency_hz = {hz:?} }}]");
        }
    }

    /// Names of the joints.
    pub fn joints(&self) -> Vec<String> {
        let robot = self.arm.robot(&[]);
        robot.model.joints().iter().map(|joint| joint.name.clone()).collect()
    }

    fn move_joints(&mut self, random: &mut impl Rng) {
        let joints = self.joints();
        let offsets: Vec<String> =
            joints.iter().map(|name| format!("{name} = {:?}", random.random_range(-0.3_f64..0.3))).collect();
        let duration_s = random.random_range(1.0_f64..2.0);
        self.reference = format!(
            "reference.point-to-point = {{ goal = {{ offset_rad = {{ {} }} }}, duration_s = {duration_s:?} }}",
            offsets.join(", ")
        );
    }

    fn press(&mut self, posture: &Posture, random: &mut impl Rng) {
        let axis = one_of(random, &self.translations());
        let toward = direction(axis) * one_of(random, &[-1.0, 1.0]);
        let most_n = 0.15 * posture.largest_force_n(&toward);
        let target_n = most_n.min(30.0) * random.random_range(0.4..1.0);
        let approaches = random.random_bool(0.7);
        let gap_m =
            if approaches { random.random_range(0.005..0.03) } else { random.random_range(0.0..0.002) };
        let sign = direction(axis).dot(&toward);
        self.force = Some(Force {
            axis,
            target_n: -sign * target_n,
            approach_m_per_s: approaches.then(|| random.random_range(0.03..0.06)),
        });
        self.wall = Some(Wall {
            point: posture.position + toward * gap_m,
            normal: -toward,
            stiffness_n_per_m: random.random_range(2e3..1e4),
        });
        self.set_mode(axis, "force");
    }

    pub fn set_mode(&mut self, axis: &str, mode: &'static str) {
        self.axes.iter_mut().filter(|(name, _)| *name == axis).for_each(|(_, of_axis)| *of_axis = mode);
    }

    fn carry(&mut self, posture: &Posture, random: &mut impl Rng) {
        self.load_kg = Some(random.random_range(0.02..0.08) * posture.largest_mass_kg());
        self.reach(random);
    }

    fn lead(&mut self, random: &mut impl Rng) {
        self.set_mode(one_of(random, &self.translations()), "compliant");
        let rms_m = 0.2 * self.arm.size_m * random.random_range(0.5..1.0);
        self.tables += &format!(
            "[environment.operator.spring]\nframe = \"{}\"\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 15.0\n\
             motion.random = {{ rms_m = {rms_m:?}, from_hz = 0.1, to_hz = 0.6, ramp_s = 1.0 }}\n",
            self.arm.frame
        );
    }

    fn give_way(&mut self, random: &mut impl Rng) {
        let axis = one_of(random, &self.translations());
        let stiffness = random.random_range(200.0_f64..800.0);
        let values: Vec<String> = self
            .translations()
            .iter()
            .map(|name| format!("{name} = {:?}", if *name == axis { stiffness } else { 1000.0 }))
            .collect();
        let rotations: Vec<String> = self
            .arm
            .axes
            .iter()
            .filter(|name| name.len() == 2)
            .map(|name| format!("{name} = 30.0"))
            .collect();
        let of_rotations = match rotations.is_empty() {
            true => String::new(),
            false => format!("stiffness_nm_per_rad = {{ {} }}, ", rotations.join(", ")),
        };
        self.impedance = Some(format!(
            "impedance = {{ stiffness_n_per_m = {{ {} }}, {of_rotations}damping_ratio = 0.8 }}\n",
            values.join(", ")
        ));
        let mut force = [0.0; 3];
        force[["x", "y", "z"].iter().position(|name| *name == axis).expect("an axis")] =
            random.random_range(3.0..10.0);
        self.tables += &format!(
            "[environment.person.pushes]\nframe = \"{}\"\npush = [{{ at_s = 1.0, duration_s = 0.5, force_n = {force:?} }}]\n",
            self.arm.frame
        );
    }

    /// Text of the task file, with the name of the robot.
    fn text(&self, robot: &str) -> String {
        let joints = self.joints();
        let starts: Vec<String> =
            joints.iter().zip(&self.start).map(|(joint, q)| format!("{joint} = {q:?}")).collect();
        let is_of_joints = self.base == Base::Joints;
        let priority = if is_of_joints { "\"hand\"" } else { "\"hand\", \"rest\"" };
        let mut text = format!(
            "robot = {robot:?}\nduration_s = {DURATION_S:?}\nsettle_s = {SETTLE_S:?}\nseed = {}\npriority = [{priority}]\n\
             friction_compensation = {{ gain = 0.8 }}\nstart_rad = {{ {} }}\n",
            self.seed,
            starts.join(", "),
        );
        let gains = format!(
            "gains = {{ frequency_rad_per_s = {:?}, damping_ratio = 1.0 }}\n",
            self.frequency_rad_per_s
        );
        if is_of_joints {
            text += &format!("[task.hand.joint-tracking]\n{gains}{}\n", self.reference);
            return text + &self.environment();
        }
        let modes: Vec<String> =
            self.axes.iter().map(|(axis, mode)| format!("{axis} = \"{mode}\"")).collect();
        text += &format!(
            "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 1.0\n[task.hand.cartesian]\nframe = \"{}\"\n\
             axes = {{ {} }}\n{}",
            self.arm.frame,
            modes.join(", "),
            self.impedance.as_ref().unwrap_or(&gains),
        );
        if let Some(Force { axis, target_n, approach_m_per_s }) = &self.force {
            let approach = approach_m_per_s
                .map_or_else(String::new, |speed| format!(", contact = {{ approach_m_per_s = {speed:?} }}"));
            text += &format!(
                "force = {{ sensor = \"{}\", target_n = {{ {axis} = {target_n:?} }}{approach} }}\n",
                self.sensor()
            );
        }
        text += &format!("{}\n", self.reference);
        text + &self.environment()
    }

    fn environment(&self) -> String {
        let (mut text, frame) = (self.tables.clone(), self.arm.frame);
        if let Some(Wall { point, normal, stiffness_n_per_m }) = &self.wall {
            let ([px, py, pz], [nx, ny, nz]): ([f64; 3], [f64; 3]) = ((*point).into(), (*normal).into());
            text += &format!(
                "[environment.wall.wall]\nframe = \"{frame}\"\npoint_m = [{px:?}, {py:?}, {pz:?}]\nnormal = [{nx:?}, {ny:?}, {nz:?}]\n\
                 stiffness_n_per_m = {stiffness_n_per_m:?}\ndamping_ns_per_m = 50.0\n"
            );
        }
        if let Some(mass_kg) = self.load_kg {
            text += &format!(
                "[environment.load.mass]\nframe = \"{frame}\"\nmass_kg = {mass_kg:?}\nput_on_s = 0.8\n"
            );
        }
        text
    }

    pub fn name(&self) -> String {
        format!("{:13} {:?} at {:.0} rad/s", self.arm.name, self.base, self.frequency_rad_per_s)
    }

    /// Writes the task with the settings of its robot.
    pub fn write(&self, folder: &str, number: usize) {
        let robot = self.arm.file();
        let robot = robot.parent().and_then(|folder| folder.canonicalize().ok()).expect("a folder");
        let text = self.text(robot.to_str().expect("a path"));
        std::fs::write(format!("{folder}/{number}.toml"), text).expect("written");
        std::fs::write(format!("{folder}/{number}.set"), self.settings.join("\n")).expect("written");
    }

    fn experiment(&self, settings: &[String]) -> Experiment {
        let text = self.text("unused");
        let read = |source| {
            TaskDefinition::from_sources(source, |_| -> Result<_, FileError> { unreachable!("no path") })
        };
        let task = read(Source::new("drawn.toml", text.clone())).unwrap_or_else(|e| panic!("{e}\n{text}"));
        let options = RunOptions { controller: self.controller, ..RunOptions::default() };
        Experiment::new(self.arm.robot(settings), task, options, Vec::new())
            .unwrap_or_else(|e| panic!("{e}\n{text}\n{settings:?}"))
    }

    /// Codes of the diagnostics, and of that of the gain margin.
    pub fn codes(&self) -> Vec<String> {
        let experiment = self.experiment(&self.settings);
        let margin = gain_margin(&experiment).and_then(|margin| margin.finding(&experiment));
        diagnostics(&experiment)
            .into_iter()
            .chain(margin)
            .map(|finding| finding.code.name().to_owned())
            .collect()
    }

    /// Codes that `opspace check` of this program prints.
    pub fn codes_of(&self, program: &Path) -> Vec<String> {
        let folder = tempfile::tempdir().expect("a folder");
        self.write(&folder.path().to_string_lossy(), 0);
        let mut command = Command::new(program);
        command.arg("check").arg(folder.path().join("0.toml")).args(["--json", "-", "--controller"]);
        command.arg(self.controller.name());
        self.settings.iter().for_each(|setting| {
            command.args(["--set", setting]);
        });
        let output = command.output().expect("the program runs");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{said}\n{}\n{:?}", self.text("unused"), self.settings);
        let result: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let findings = result["files"][0]["findings"].as_array().expect("findings");
        findings.iter().filter_map(|finding| Some(finding["code"].as_str()?.to_owned())).collect()
    }

    /// True if a run is completed, and has neither a failure nor a note, with the stated gains of the position loops and with gains that
    /// are a tenth higher.
    pub fn runs_well(&self) -> bool {
        [1.0, 1.0 + GAIN_ERROR].into_iter().all(|gain| self.runs_well_with(gain))
    }

    fn runs_well_with(&self, gain: f64) -> bool {
        let true_gain = format!("robot.simulated.true_over_nominal={{ kp = {gain:?} }}");
        let settings: Vec<String> = self.settings.iter().cloned().chain([true_gain]).collect();
        let experiment = self.experiment(&settings);
        let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).expect("a run");
        let log = Recording::from_bytes(finished.sink.get_ref()).expect("a log");
        let summary = experiment.summary(&log, &finished.record, None);
        finished.record.fault.is_none() && summary.findings.notes().next().is_none()
    }
}

/// Setting of a tool on an arm.
pub fn tool(arm: &Arm, mass_kg: f64) -> String {
    format!("robot.tool.gripper={{ on = \"{}\", mass_kg = {mass_kg:?} }}", arm.link)
}
