//! Streamed targets: motion of tasks with targets, between targets and without targets; task sets selected by number.

use crate::common::{self, File, Numbers, at_state, control_context, sampled, seven_joints};
use nalgebra::Vector3;
use opspace_backend::Observable;
use opspace_control::{
    AxisMode, CartesianReference, CartesianTarget, ControlInput, Controller, InverseKinematicsController,
    JointTarget, Measurement, OperationalSpaceController, Reason, STOP_S, Target, TargetError, Targets,
    Trajectory,
};
use opspace_model::{Data, Model, Placement, frame_placement};
use opspace_testing::allocation::allocations;
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const PERIOD_S: f64 = 1e-3;

/// Remaining difference half a second after the end of the blend, m: targets in every cycle restart the blend, which
/// then is an exponential decay.
const JOINED: f64 = 1e-9;

const Q: [f64; 7] = [0.3, 0.7, -0.4, -1.1, 0.2, 0.9, 0.5];
const ALL: &str =
    r#"{ x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }"#;
const XYZ: &str = r#"{ x = "motion", y = "motion", z = "motion" }"#;
const LIMITS: &str = "shape = 'generated', velocity_m_per_s = 0.5, acceleration_m_per_s2 = 2.0, jerk_m_per_s3 = 20.0, \
    angular_velocity_rad_per_s = 1.0, angular_acceleration_rad_per_s2 = 4.0, angular_jerk_rad_per_s3 = 40.0";

/// Task set of a hand with a reference, above joint damping.
fn hand(axes: &str, reference: &str, more: &str) -> String {
    format!(
        "priority = [\"hand\", \"rest\"]\n[task.hand.cartesian]\nframe = \"hand\"\naxes = {axes}\n\
         reference.{reference}\ngains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n{more}\n\
         [task.rest.joint-damping]\ndamping_nms_per_rad = 1.0\n"
    )
}

fn streamed(axes: &str, more: &str) -> String {
    hand(axes, &format!("streamed = {{ {more} }}"), "")
}

/// Task set of all joints with a reference.
fn joints(reference: &str) -> String {
    format!(
        "priority = [\"all\"]\n[task.all.joint-tracking]\nreference.{reference}\n\
         gains = {{ frequency_rad_per_s = 15.0, damping_ratio = 1.0 }}\n"
    )
}

fn controller(model: &Model, text: &str) -> OperationalSpaceController {
    OperationalSpaceController::new(model, &File::read(text).task_set(), &control_context(model, "hand"))
        .unwrap_or_else(|e| panic!("{e}"))
}

/// A controller on an arm at rest.
struct Bench {
    model: Model,
    data: Data,
    measurement: Measurement,
    controller: OperationalSpaceController,
    targets: Targets,
    torque: Vec<f64>,
    row: Vec<f64>,
    clock_s: f64,
    period_s: f64,
}

/// The robot's clock at the start, s.
const CLOCK_S: f64 = 40.0;

impl Bench {
    fn new(text: &str) -> Self {
        let model = seven_joints();
        let controller = controller(&model, text);
        Self::with_controller(model, controller)
    }

    fn with_controller(model: Model, mut controller: OperationalSpaceController) -> Self {
        let n = model.n();
        let (data, measurement) = at_state(&model, &Q[..n], &vec![0.0; n], 0.0);
        let targets = controller.targets();
        let (base, row) = (common::input(&model, &data, &measurement), row(&controller));
        controller.start(&ControlInput { targets: &targets, clock_s: CLOCK_S, ..base });
        Self {
            data,
            measurement,
            controller,
            targets,
            torque: vec![0.0; n],
            row,
            clock_s: CLOCK_S,
            period_s: PERIOD_S,
            model,
        }
    }

    fn hand(&self) -> CartesianTarget {
        CartesianTarget::of(&self.targets, "hand").expect("a streamed task")
    }

    /// Pose of the hand.
    fn placement(&self) -> Placement {
        frame_placement(&self.model, &self.data, self.model.frame_id("hand").expect("a frame"))
    }

    /// Runs one cycle; the arm does not move.
    fn cycle(&mut self) {
        let base = common::input(&self.model, &self.data, &self.measurement);
        let input = ControlInput { targets: &self.targets, clock_s: self.clock_s, ..base };
        self.controller.update(&input, &mut self.torque);
        self.controller.sample(&mut self.row);
        self.clock_s += self.period_s;
        self.measurement.time_s += self.period_s;
    }

    fn held_cycle(&mut self) {
        let base = common::input(&self.model, &self.data, &self.measurement);
        let input = ControlInput { targets: &self.targets, clock_s: self.clock_s, ..base };
        self.controller.observe_while_held(&input);
        self.clock_s += self.period_s;
        self.measurement.time_s += self.period_s;
    }

    fn resume(&mut self) {
        let base = common::input(&self.model, &self.data, &self.measurement);
        let input = ControlInput { targets: &self.targets, clock_s: self.clock_s, ..base };
        self.controller.resume(&input);
    }

    fn signal(&self, name: &str) -> Vec<f64> {
        sampled(&self.controller, name)
    }

    fn stale(&self) -> bool {
        self.signal("hand.target_stale") == [1.0]
    }

    /// Desired acceleration of the task's rows.
    fn acceleration(&self) -> Vec<f64> {
        let task = self.controller.tasks().tasks().next().expect("a task");
        task.acceleration().as_slice()[..task.rows()].to_vec()
    }
}

fn row(controller: &dyn Observable) -> Vec<f64> {
    vec![0.0; controller.signals().iter().map(|s| s.len()).sum()]
}

fn six(motion: &opspace_model::Motion) -> [f64; 6] {
    common::six(motion).into()
}

fn write(hand: &mut CartesianTarget, target: &Target, targets: &mut Targets, stamp_s: f64) {
    hand.placement(&target.placement).expect("a pose");
    hand.twist(six(&target.velocity))
        .expect("finite")
        .acceleration(six(&target.acceleration))
        .expect("finite");
    hand.write(targets, stamp_s).expect("good values");
}

const SINUSOID: &str = "sinusoid = { ramp_s = 0.5, x = [{ amplitude_m = 0.05, frequency_hz = 0.5 }], \
    z = [{ amplitude_m = 0.03, frequency_hz = 0.8 }], ry = [{ amplitude_rad = 0.1, frequency_hz = 0.5 }] }";

/// Compared: desired accelerations of a task with a sinusoid in its file with those of a task to which the same poses,
/// twists and accelerations are streamed in every cycle. The extrapolation does not know the jerk: the difference is at
/// most the change of acceleration by the largest jerk in a few periods, and half of that for half the period.
#[test]
fn streamed_motion_matches_file_reference_acceleration() {
    /// Bound of the difference, in multiples of the change of acceleration in a period.
    const PERIODS: f64 = 2.0;
    /// Range of the ratio of the differences for half and whole period: 0.5 for a first-order difference.
    const HALVED: [f64; 2] = [0.4, 0.6];
    let [whole, half] = [PERIOD_S, 0.5 * PERIOD_S].map(streamed_and_filed);
    for [difference, change, largest] in [whole, half] {
        assert!(difference < PERIODS * change, "{difference} and {change} in a period");
        assert!(largest > 100.0 * difference, "the motion asks for accelerations: {largest}");
    }
    let ratio = half[0] / whole[0];
    assert!((HALVED[0]..HALVED[1]).contains(&ratio), "{ratio}");
}

/// Returns the largest difference between the desired accelerations of a sinusoid from a file and a streamed one, and,
/// of the former, the largest change in a period and the largest value.
fn streamed_and_filed(period_s: f64) -> [f64; 3] {
    let (mut of_file, mut of_stream) = (Bench::new(&hand(ALL, SINUSOID, "")), Bench::new(&streamed(ALL, "")));
    (of_file.period_s, of_stream.period_s) = (period_s, period_s);
    let reference: BTreeMap<String, CartesianReference> =
        toml::from_str(&format!("reference.{SINUSOID}")).expect("a reference");
    let mut trajectory = Trajectory::new(&reference["reference"]);
    let home = of_file.placement();
    trajectory.start(&home, &Target::at_rest(home), &nalgebra::Matrix3::identity());
    let mut target = of_stream.hand();
    let ([mut difference, mut change, mut largest], mut before) = ([0.0_f64; 3], None::<Vec<f64>>);
    for k in 0..(2.5 / period_s) as u32 {
        let clock_s = of_stream.clock_s;
        write(&mut target, &trajectory.at(f64::from(k) * period_s), &mut of_stream.targets, clock_s);
        of_file.cycle();
        of_stream.cycle();
        let filed = of_file.acceleration();
        for (i, (a, b)) in filed.iter().zip(of_stream.acceleration()).enumerate() {
            difference = difference.max((a - b).abs());
            change = change.max(before.as_ref().map_or(0.0, |before| (a - before[i]).abs()));
            largest = largest.max(a.abs());
        }
        before = Some(filed);
    }
    [difference, change, largest]
}

/// Returns the reference position and velocity of a bench in a cycle.
fn reference(bench: &Bench) -> [Vector3<f64>; 2] {
    ["hand.reference", "hand.reference_velocity"].map(|name| Vector3::from_column_slice(&bench.signal(name)))
}

/// Compared: changes of the reference and of its velocity between cycles, under random targets, pauses and returns,
/// with a bound: the limits of the generator, or 60 d/T³ and 5.8 d/T² for a difference d that fades within T.
#[test]
fn reference_never_jumps_under_random_targets() {
    // The targets are within 0.1 m of the start in each direction, and within 0.35 m of each other.
    let (away, blend_s) = (0.35, 0.1);
    let peak_acceleration = 2.0 * 5.8 * away / (blend_s * blend_s);
    // Restarts during a blend at most double the values.
    for (shape, velocity, acceleration) in
        [("", 2.0 * 1.9 * away / blend_s, peak_acceleration), (LIMITS, 0.9, 3.5)]
    {
        for seed in 0..8 {
            let mut numbers = Numbers::new(seed + 1);
            let mut bench = Bench::new(&streamed(ALL, shape));
            let (home, mut target) = (bench.placement(), bench.hand());
            let mut before = reference(&bench);
            before[0] = home.translation;
            let mut pause = 0;
            for cycle in 0..3000 {
                if pause > 0 {
                    pause -= 1;
                } else if numbers.below(20) == 0 {
                    let mut placement = home;
                    placement.translation += numbers.vector3(0.1);
                    placement.rotation *= opspace_control::orientation::exp(&numbers.vector3(0.3));
                    target.placement(&placement).expect("a pose");
                    let clock_s = bench.clock_s;
                    target.write(&mut bench.targets, clock_s).expect("good values");
                } else if numbers.below(200) == 0 {
                    pause = numbers.below(600);
                }
                bench.cycle();
                let now = reference(&bench);
                let (step, change) = ((now[0] - before[0]).norm(), (now[1] - before[1]).norm());
                assert!(now[1].norm() < velocity, "{shape}: {} m/s in cycle {cycle}", now[1].norm());
                assert!(step < velocity * PERIOD_S, "{shape}: a step of {step} m in cycle {cycle}");
                assert!(change < acceleration * PERIOD_S, "{shape}: a step of {change} m/s in cycle {cycle}");
                before = now;
            }
        }
    }
}

/// Compared: after a target becomes stale, the reference velocity after the documented time with zero, and the
/// displacement with half the speed times that time; later, the reference some time after the return of the target with
/// the target.
#[test]
fn stale_target_stops_reference_until_renewed() {
    let mut bench = Bench::new(&streamed(ALL, "timeout_s = 0.05"));
    let (home, mut target) = (bench.placement(), bench.hand());
    let speed = Vector3::new(0.2, 0.0, -0.1);
    let at = |time_s: f64| Target {
        placement: Placement { translation: home.translation + speed * time_s, ..home },
        velocity: opspace_model::Motion { linear: speed, angular: Vector3::zeros() },
        ..Target::at_rest(home)
    };
    let mut stamp_s = 0.0;
    for k in 0..1500 {
        stamp_s = bench.clock_s;
        write(&mut target, &at(f64::from(k) * PERIOD_S), &mut bench.targets, stamp_s);
        bench.cycle();
        assert!(!bench.stale());
    }
    let [_, velocity] = reference(&bench);
    assert!((velocity - speed).norm() < 1e-9, "the target is joined: {velocity}");
    let mut from = Vector3::zeros();
    while !bench.stale() {
        from = reference(&bench)[0];
        bench.cycle();
    }
    let age_s = bench.signal("hand.target_age_s")[0];
    assert!(
        (age_s - (bench.clock_s - PERIOD_S - stamp_s)).abs() < 1e-12 && (age_s - 0.05).abs() < 2.0 * PERIOD_S
    );
    for _ in 0..(STOP_S / PERIOD_S) as usize + 2 {
        bench.cycle();
    }
    let [rest, velocity] = reference(&bench);
    assert_eq!(velocity, Vector3::zeros());
    let way = (rest - from - speed * (0.5 * STOP_S + PERIOD_S)).norm();
    assert!(way < 1e-3 * speed.norm(), "off by {way}");
    assert_eq!(bench.controller.stale_target(), None, "on_timeout is hold");
    let goal = Target::at_rest(home);
    for _ in 0..1500 {
        let clock_s = bench.clock_s;
        write(&mut target, &goal, &mut bench.targets, clock_s);
        let before = reference(&bench)[0];
        bench.cycle();
        assert!(!bench.stale());
        assert!((reference(&bench)[0] - before).norm() < 2e-3, "a jump");
    }
    assert!((reference(&bench)[0] - home.translation).norm() < JOINED, "joined again");
}

/// Compared: the reported task and age with the index of the task and the time since its stamp.
#[test]
fn stale_target_stop_request_is_reported() {
    let mut bench = Bench::new(&streamed(ALL, "timeout_s = 0.05, on_timeout = 'stop'"));
    let (home, mut target) = (bench.placement(), bench.hand());
    for _ in 0..200 {
        bench.cycle();
        assert_eq!(bench.controller.stale_target(), None, "no target has come yet");
    }
    write(&mut target, &Target::at_rest(home), &mut bench.targets, bench.clock_s);
    let stamp_s = bench.clock_s;
    while bench.controller.stale_target().is_none() {
        bench.cycle();
        assert!(bench.clock_s < stamp_s + 1.0, "it must become stale");
    }
    let stale = bench.controller.stale_target().expect("it is stale");
    assert_eq!(stale.task, 0);
    assert!((stale.age_s - (bench.clock_s - PERIOD_S - stamp_s)).abs() < 1e-12);
    assert!(stale.age_s > 0.05 && stale.age_s < 0.052);
}

/// Compared: the reference without a target, with a target during a hold, and directly after the hold, with the
/// position of the hand.
#[test]
fn reference_holds_before_target_and_resumes_at_hand() {
    let mut bench = Bench::new(&streamed(ALL, ""));
    let (home, mut target) = (bench.placement(), bench.hand());
    for _ in 0..50 {
        bench.cycle();
        assert_eq!(reference(&bench), [home.translation, Vector3::zeros()]);
        assert!(bench.signal("hand.target_age_s")[0].is_nan());
    }
    let far = Placement { translation: home.translation + Vector3::new(0.1, 0.0, 0.0), ..home };
    for _ in 0..1200 {
        write(&mut target, &Target::at_rest(far), &mut bench.targets, bench.clock_s);
        bench.held_cycle();
    }
    assert!(
        (reference(&bench)[0] - far.translation).norm() < 100.0 * JOINED,
        "references go on while the robot is held"
    );
    bench.resume();
    assert!((reference(&bench)[0] - home.translation).norm() < 1e-12);
    bench.cycle();
    assert!((reference(&bench)[0] - home.translation).norm() < 1e-9);
}

/// Compared: desired accelerations and forces in a cycle with streamed modes, gains and target force with those of a
/// controller whose file contains these values; with a streamed reference, and with a tunable task that holds.
#[test]
fn streamed_modes_gains_and_forces_apply_immediately() {
    for reference in ["reference.streamed = {}", "reference = \"hold\"\ntunable = true"] {
        settings_apply_immediately(reference);
    }
}

fn settings_apply_immediately(reference: &str) {
    const SENSOR: &str = "force = { sensor = 'wrist', target_n = { x = 0.0 }, integral_per_s = { x = 0.0, z = 0.0 }, ramp_s = 0.0 }";
    let axes = r#"{ x = "force", y = "motion", z = "motion" }"#;
    let text = hand(axes, "streamed = {}", SENSOR).replace("reference.streamed = {}", reference);
    let mut bench = Bench::new(&text);
    bench.measurement.wrenches[0].linear = Vector3::new(1.0, 2.0, 3.0);
    bench.measurement.dq.fill(0.1);
    assert!(opspace_model::update(&bench.model, &mut bench.data, &Q, &[0.1; 7]));
    // Waits until the force filter has settled.
    for _ in 0..100 {
        bench.cycle();
    }
    assert_eq!(bench.signal("hand.modes"), [2.0, 0.0, 0.0, 3.0, 3.0, 3.0]);
    let mut target = bench.hand();
    let (nan, [m, c, f]) = (f64::NAN, AxisMode::IN_TASK.map(Some));
    target.gains([nan, 20.0, nan, nan, nan, nan], [nan, 0.5, nan, nan, nan, nan]).expect("good gains");
    target.modes([c, m, f, None, None, None]).expect("good modes");
    target.wrench([nan, nan, -7.0, nan, nan, nan]).expect("finite");
    target.write(&mut bench.targets, bench.clock_s).expect("good values");
    bench.cycle();
    assert_eq!(bench.signal("hand.modes"), [1.0, 0.0, 2.0, 3.0, 3.0, 3.0]);
    let changed = "priority = [\"hand\", \"rest\"]\n[task.hand.cartesian]\nframe = \"hand\"\n\
        axes = { x = \"compliant\", y = \"motion\", z = \"force\" }\nreference = \"hold\"\n\
        gains = { frequency_rad_per_s = 20.0, damping_ratio = 0.5 }\n\
        force = { sensor = 'wrist', target_n = { z = -7.0 }, integral_per_s = { z = 0.0 }, ramp_s = 0.0 }\n\
        [task.rest.joint-damping]\ndamping_nms_per_rad = 1.0\n";
    let mut other = Bench::new(changed);
    (other.measurement, other.data) = (bench.measurement.clone(), bench.data.clone());
    other.controller.start(&common::input(&other.model, &other.data, &other.measurement));
    other.cycle();
    other.cycle();
    for (a, b) in bench.acceleration().iter().zip(other.acceleration()) {
        assert!((a - b).abs() < 1e-12, "{a} and {b}");
    }
    for (a, b) in bench.signal("hand.force").iter().zip(other.signal("hand.force")) {
        assert!((a - b).abs() < 1e-9, "{a} and {b}");
    }
    // Return to the configured values.
    target.clear();
    target.write(&mut bench.targets, bench.clock_s).expect("good values");
    bench.cycle();
    assert_eq!(bench.signal("hand.modes"), [2.0, 0.0, 0.0, 3.0, 3.0, 3.0]);
}

/// Compared: torques of a tunable task, before a change and after its end, with those of the same task that is not tunable,
/// bit for bit; its reference, which goes on while the gains differ; and the inputs that it has.
#[test]
fn tunable_task_keeps_its_reference() {
    let [mut fixed, mut tunable] = ["", "tunable = true"].map(|more| Bench::new(&hand(ALL, SINUSOID, more)));
    let mut target = tunable.hand();
    let refused = target.pose([0.0; 3], [1.0, 0.0, 0.0, 0.0]).map(|_| ()).expect_err("it has a reference");
    assert!(refused.to_string().contains("not `streamed`: it has no input 'pose'"), "{refused}");
    assert!(target.twist([0.0; 6]).is_err() && target.acceleration([0.0; 6]).is_err());
    for k in 0..300 {
        match k {
            100 => drop(target.gains([30.0; 6], [0.7; 6]).expect("good gains")),
            200 => drop(target.clear()),
            _ => {}
        }
        if k % 100 == 0 && k > 0 {
            target.write(&mut tunable.targets, tunable.clock_s).expect("good values");
        }
        fixed.cycle();
        tunable.cycle();
        assert_eq!(reference(&fixed), reference(&tunable), "cycle {k}");
        let is_changed = (100..200).contains(&k);
        assert_eq!(fixed.torque != tunable.torque, is_changed, "cycle {k}");
    }
    let names: Vec<_> = tunable.targets.layout().signals.iter().map(|signal| &signal.name[..]).collect();
    let expected = ["wrench", "frequency_rad_per_s", "damping_ratio", "modes"];
    assert_eq!(names[3..], expected.map(|name| format!("target.hand.{name}")));
    assert!(fixed.targets.layout().signals.is_empty());
}

/// Compared: the reference in the cycle in which a compliant axis, far from its earlier reference, is switched to
/// motion, with the position of the hand.
#[test]
fn axis_switched_to_motion_starts_at_hand() {
    let axes = r#"{ x = "compliant", y = "motion", z = "motion" }"#;
    let mut bench = Bench::new(&streamed(axes, ""));
    let mut target = bench.hand();
    bench.cycle();
    let q = Q.map(|q| q + 0.2);
    assert!(opspace_model::update(&bench.model, &mut bench.data, &q, &[0.0; 7]));
    target.modes([Some(AxisMode::Motion), None, None, None, None, None]).expect("a good mode");
    let before = reference(&bench)[0];
    target.write(&mut bench.targets, bench.clock_s).expect("good values");
    bench.cycle();
    let (now, hand) = (reference(&bench)[0], bench.placement().translation);
    assert!((now.x - hand.x).abs() < 1e-12 && (now.x - before.x).abs() > 0.01, "{now} and {hand}");
    assert!((now.y - before.y).abs() < 1e-12 && (now.z - before.z).abs() < 1e-12);
}

#[test]
fn refused_inputs_name_allowed_values() {
    let bench = Bench::new(&streamed(r#"{ x = "compliant", z = "motion" }"#, ""));
    let mut target = bench.hand();
    let refused = |result: Result<&mut CartesianTarget, TargetError>, words: &[&str]| {
        let text = result.map(|_| ()).expect_err("it is refused").to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    };
    let only = |axis: usize, mode| std::array::from_fn(|i| (i == axis).then_some(mode));
    refused(target.modes(only(1, AxisMode::Motion)), &["axis y", "hand", "x, z"]);
    refused(target.modes(only(0, AxisMode::Free)), &["axis x", "x, z"]);
    refused(target.modes(only(2, AxisMode::Force)), &["axis z", "force", "motion, compliant"]);
    refused(target.pose([0.0; 3], [0.9, 0.0, 0.0, 0.0]), &["unit quaternion", "0.001", "0.9"]);
    refused(target.gains([0.0; 6], [1.0; 6]), &["frequency_rad_per_s", "axis x", "above 0"]);
    refused(target.gains([1.0; 6], [-1.0; 6]), &["damping_ratio", "0 or above"]);
    refused(target.twist([f64::NAN; 6]), &["finite"]);
    target.pose([0.0; 3], [1.0005, 0.0, 0.0, 0.0]).expect("within the tolerance");
    assert_eq!(target.inputs()[0].1[3], 1.0, "it is normalised");
    let impedance = "impedance = { stiffness_n_per_m = 500.0 }\n";
    let text = hand(XYZ, "streamed = {}", impedance)
        .replace("gains = { frequency_rad_per_s = 15.0, damping_ratio = 1.0 }\n", "");
    refused(Bench::new(&text).hand().gains([1.0; 6], [1.0; 6]), &["hand", "gains"]);
    let error = CartesianTarget::of(&bench.targets, "rest").expect_err("no inputs");
    assert!(error.to_string().contains("the tasks with inputs are: hand"), "{error}");
    let mut joints = JointTarget::of(&Bench::new(&joints("streamed = {}")).targets, "all").expect("a task");
    assert!(joints.position(&[0.0; 3]).expect_err("three of seven").to_string().contains("7 values"));
    assert!(JointTarget::of(&bench.targets, "hand").is_err());
}

/// Compared: the reference under invalid raw values with the start: they are ignored.
#[test]
fn invalid_raw_targets_are_ignored() {
    let mut bench = Bench::new(&streamed(XYZ, ""));
    let home = bench.placement().translation;
    let task = bench.targets.task("hand").expect("a task");
    let [pose, modes, gains] = ["pose", "modes", "frequency_rad_per_s"]
        .map(|name| bench.targets.input(&task, name).expect("an input"));
    let nan = f64::NAN;
    for _ in 0..300 {
        let clock_s = bench.clock_s;
        let values: [(&opspace_control::InputHandle, &[f64]); 3] = [
            (&pose, &[nan, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0]),
            (&modes, &[3.0, 7.5, -1.0, 0.0, 1.0, 2.0]),
            (&gains, &[-1.0, 0.0, nan, 5.0, 5.0, 5.0]),
        ];
        bench.targets.write(&task, clock_s, &values).expect("no value is infinite");
        bench.cycle();
    }
    assert_eq!(reference(&bench), [home, Vector3::zeros()]);
    assert_eq!(bench.signal("hand.modes"), [0.0, 0.0, 0.0, 3.0, 3.0, 3.0]);
    assert!(bench.torque.iter().all(|torque| torque.is_finite()));
}

/// Compared: references of arms on a wall, a ceiling and a slope with the streamed poses, which are in the world, and their torques in a
/// world without gravity with those of the upright arm under the same motion of its base frame.
#[test]
fn streamed_poses_of_mounted_arms_are_in_the_world() {
    const ROUNDING: f64 = 1e-9;
    let text = streamed(ALL, "");
    let in_base = |base: Placement| {
        let model = seven_joints().with_gravity(Vector3::zeros()).with_base(base);
        let controller = controller(&model, &text);
        let mut bench = Bench::with_controller(model, controller);
        let (home, mut target) = (bench.placement(), bench.hand());
        let way = base.rotation * Vector3::new(0.05, -0.03, 0.02);
        let goal = Placement { translation: home.translation + way, ..home };
        let mut torques = Vec::new();
        for _ in 0..2000 {
            let clock_s = bench.clock_s;
            write(&mut target, &Target::at_rest(goal), &mut bench.targets, clock_s);
            bench.cycle();
            torques.extend_from_slice(&bench.torque);
        }
        assert!((reference(&bench)[0] - goal.translation).norm() < JOINED);
        torques
    };
    let upright = in_base(Placement::identity());
    let largest = upright.iter().fold(0.0_f64, |most, torque| most.max(torque.abs()));
    for rpy_rad in [[0.0, FRAC_PI_2, 0.0], [PI, 0.0, 0.0], [0.3, -0.4, 1.2]] {
        let mounted = in_base(Placement::from_rpy(rpy_rad, [0.4, -0.2, 2.5]));
        let errors = mounted.iter().zip(&upright).map(|(mounted, upright)| (mounted - upright).abs());
        let error = errors.fold(0.0, f64::max);
        assert!(largest > 1.0 && error < ROUNDING * largest, "{rpy_rad:?}: {error} of {largest} Nm");
    }
}

/// Compared: the reference of a joint after a target that is more than half a turn away with the target, less a turn if the joint is
/// continuous.
#[test]
fn streamed_targets_of_continuous_joints_take_the_shortest_way() {
    const AWAY_RAD: f64 = 4.0;
    for reference in [
        "streamed = {}",
        "streamed = { shape = 'generated', velocity_rad_per_s = 8.0, acceleration_rad_per_s2 = 50.0, jerk_rad_per_s3 = 1000.0 }",
    ] {
        for (kind, end) in [("continuous", Q[0] + AWAY_RAD - TAU), ("revolute", Q[0] + AWAY_RAD)] {
            let urdf = format!(
                "<robot name='one'><link name='base'/><joint name='j1' type='{kind}'><parent link='base'/><child link='hand'/>\
                 <limit lower='-9' upper='9' velocity='9' effort='9'/></joint><link name='hand'><inertial><mass value='1'/>\
                 <inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link></robot>"
            );
            let model = Model::from_urdf(&urdf).expect("a URDF").model;
            let all = controller(&model, &joints(reference));
            let mut bench = Bench::with_controller(model, all);
            let mut target = JointTarget::of(&bench.targets, "all").expect("a task");
            for _ in 0..3000 {
                target.position(&[Q[0] + AWAY_RAD]).expect("finite");
                target.write(&mut bench.targets, bench.clock_s).expect("good values");
                bench.cycle();
            }
            assert!(
                (bench.signal("all.reference")[0] - end).abs() < JOINED,
                "{kind}: {:?}",
                bench.signal("all.reference")
            );
        }
    }
}

/// Compared: joint references that are streamed in every cycle with the motion itself, and the velocity after the last
/// target with zero.
#[test]
fn streamed_joint_references_follow_and_stop() {
    const TOLERANCE: f64 = 1e-4;
    let some = "priority = [\"all\"]\n[task.all.joint-tracking]\njoints = [\"j4\", \"j2\"]\nreference.streamed = {}\n\
                gains = { frequency_rad_per_s = 15.0, damping_ratio = 1.0 }\n";
    for (text, places) in
        [(joints("streamed = {}"), vec![0, 1, 2, 3, 4, 5, 6]), (some.to_owned(), vec![3, 1])]
    {
        let mut bench = Bench::new(&text);
        let mut target = JointTarget::of(&bench.targets, "all").expect("a task");
        for k in 0..2000 {
            let (sin, cos) = (3.0 * f64::from(k) * PERIOD_S).sin_cos();
            let each = |of: &dyn Fn(usize) -> f64| places.iter().map(|&joint| of(joint)).collect::<Vec<_>>();
            let (q, dq) = (each(&|joint| Q[joint] + 0.2 * (1.0 - cos)), each(&|_| 0.6 * sin));
            target.position(&q).expect("finite").velocity(&dq).expect("finite");
            target.acceleration(&each(&|_| 1.8 * cos)).expect("finite");
            target.write(&mut bench.targets, bench.clock_s).expect("good values");
            bench.cycle();
            let (reference, speed) = (bench.signal("all.reference"), bench.signal("all.reference_velocity"));
            for (place, &joint) in places.iter().enumerate() {
                // The blend to the first target takes one second: its acceleration starts with a step.
                let settled = k > 1100;
                assert!(
                    !settled || (reference[joint] - q[place]).abs() < TOLERANCE,
                    "joint {joint}, cycle {k}"
                );
                assert!(
                    !settled || (speed[joint] - dq[place]).abs() < 20.0 * TOLERANCE,
                    "joint {joint}, cycle {k}"
                );
            }
        }
        for _ in 0..400 {
            bench.cycle();
        }
        assert_eq!(bench.signal("all.target_stale"), [1.0]);
        assert_eq!(bench.signal("all.reference_velocity"), vec![0.0; 7]);
        if places.len() < 7 {
            assert_eq!(bench.signal("all.reference")[0], Q[0], "a joint without input holds");
        }
    }
}

/// Compared: the pose of the position controller under a constant streamed pose with this pose.
#[test]
fn position_controller_follows_streamed_poses() {
    let model = seven_joints();
    let file = File::read(&streamed(ALL, LIMITS));
    let mut ik =
        InverseKinematicsController::new(&model, &file.task_set(), &control_context(&model, "hand"), None)
            .unwrap_or_else(|e| panic!("{e}"));
    let (data, mut measurement) = at_state(&model, &Q, &[0.0; 7], 0.0);
    let mut targets = ik.targets();
    ik.start(&common::input(&model, &data, &measurement));
    let mut goal = frame_placement(&model, &data, model.frame_id("hand").expect("a frame"));
    goal.translation.x += 0.05;
    let mut target = CartesianTarget::of(&targets, "hand").expect("a streamed task");
    let mut q = [0.0; 7];
    for k in 0..2000 {
        measurement.time_s = f64::from(k) * PERIOD_S;
        if k % 10 == 0 {
            target.placement(&goal).expect("a pose").write(&mut targets, measurement.time_s).expect("good");
        }
        let input = ControlInput { targets: &targets, ..common::input(&model, &data, &measurement) };
        ik.update(&input, &mut q);
    }
    let (data, _) = at_state(&model, &q, &[0.0; 7], 0.0);
    let reached = frame_placement(&model, &data, model.frame_id("hand").expect("a frame"));
    assert!((reached.translation - goal.translation).norm() < 1e-6, "{reached:?}");
}

/// Compared: the numbers of the active task sets and the tasks' references with the requested numbers.
#[test]
fn task_sets_are_selected_by_number() {
    let model = seven_joints();
    let mut controller = controller(&model, &streamed(XYZ, ""));
    let soft = File::read(&streamed(r#"{ x = "compliant", y = "motion" }"#, ""));
    let rigid =
        File::read(&hand(XYZ, "hold = []", "").replace("reference.hold = []", "reference = \"hold\""));
    for (file, number) in [(&soft, 1), (&rigid, 2)] {
        let prepared = controller.prepare(&model, &file.task_set()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(controller.add_task_set(prepared), Ok(number));
    }
    let scheduled = controller.prepare(&model, &soft.task_set()).unwrap_or_else(|e| panic!("{e}"));
    controller.schedule(0.02, scheduled);
    let mut bench = Bench::with_controller(model, controller);
    let in_force = |bench: &Bench| (bench.controller.task_set(), bench.signal("task_set"));
    bench.cycle();
    assert_eq!(in_force(&bench), (0, vec![0.0]));
    for (asked, number) in [(1, 1), (2, 2), (9, 2), (u32::MAX, 2), (0, 0), (1, 1)] {
        bench.targets.choose_task_set(asked);
        bench.cycle();
        assert_eq!(in_force(&bench), (number, vec![number as f64]), "{asked} is asked for");
        assert!(bench.torque.iter().all(|torque| torque.is_finite()));
    }
    assert_eq!(bench.controller.tasks().tasks().next().map(|task| task.rows()), Some(2));
    for _ in 0..30 {
        bench.cycle();
    }
    assert_eq!(in_force(&bench).0, 1, "the number asked for stays in force");
    // Return to the schedule.
    bench.targets.set_row(&vec![f64::NAN; bench.targets.row().len()]);
    bench.cycle();
    assert_eq!(in_force(&bench).0, 3, "the scheduled one");
}

/// Compared: torque steps when a task set is selected by number with the robot's torque rate limit.
#[test]
fn torque_rate_is_limited_at_task_set_switch() {
    const RATE: f64 = 200.0;
    let model = seven_joints();
    let mut context = control_context(&model, "hand");
    context.limits.torque_rate = vec![RATE; 7];
    let files = ["15.0", "60.0"].map(|gain| File::read(&streamed(XYZ, "").replace("15.0", gain)));
    let mut controller =
        OperationalSpaceController::new(&model, &files[0].task_set(), &context).expect("good");
    let prepared = controller.prepare(&model, &files[1].task_set()).expect("good");
    controller.add_task_set(prepared).expect("the same inputs");
    let mut bench = Bench::with_controller(model, controller);
    let (data, _) = at_state(&bench.model, &Q.map(|q| q + 0.05), &[0.0; 7], 0.0);
    bench.data = data;
    for _ in 0..200 {
        bench.cycle();
    }
    let mut largest: f64 = 0.0;
    for k in 0..100_u32 {
        let before = bench.torque.clone();
        bench.targets.choose_task_set(k / 50);
        bench.cycle();
        for (a, b) in bench.torque.iter().zip(&before) {
            largest = largest.max((a - b).abs());
        }
    }
    assert!(largest > 0.5 * RATE * PERIOD_S && largest <= RATE * PERIOD_S * (1.0 + 1e-6), "{largest}");
}

/// A task with other inputs than the task of the same name in another set is an error; one without inputs is not.
#[test]
fn equally_named_tasks_need_equal_inputs() {
    let model = seven_joints();
    let of = |joints: &str| {
        let text = "priority = [\"some\"]\n[task.some.joint-tracking]\nreference.streamed = {}\n\
                    gains = { frequency_rad_per_s = 15.0, damping_ratio = 1.0 }\n";
        File::read(&format!("{text}joints = [{joints}]\n"))
    };
    let mut controller = controller(&model, &streamed(XYZ, ""));
    let one = controller.prepare(&model, &of("\"j1\"").task_set()).expect("a good set");
    controller.add_task_set(one).expect("a new task");
    let error = controller.prepare(&model, &of("\"j1\", \"j2\"").task_set()).expect_err("other inputs");
    assert_eq!(
        (error.key(), error.reason()),
        ("task.some", &Reason::InputsChanged { name: "some".to_owned() })
    );
}

/// Compared: torques of a run with those of a second run whose targets are the rows of the first, bit for bit.
#[test]
fn replayed_target_rows_reproduce_torques() {
    let text = streamed(XYZ, "");
    let run = |rows: Option<&[Vec<f64>]>| {
        let mut bench = Bench::new(&text);
        let (home, mut target, mut numbers) = (bench.placement(), bench.hand(), Numbers::new(3));
        let (mut torques, mut kept) = (Vec::new(), Vec::new());
        for k in 0..600 {
            match rows {
                Some(rows) => bench.targets.set_row(&rows[k]),
                None if k % 7 == 0 && k % 300 < 150 => {
                    let translation = home.translation + numbers.vector3(0.05);
                    let pose = Target::at_rest(Placement { translation, ..home });
                    target
                        .modes([Some(AxisMode::IN_TASK[numbers.below(2)]), None, None, None, None, None])
                        .expect("ok");
                    write(&mut target, &pose, &mut bench.targets, bench.clock_s);
                }
                None => {}
            }
            kept.push(bench.targets.row().to_vec());
            bench.cycle();
            torques.extend(bench.torque.iter().map(|torque| torque.to_bits()));
        }
        (torques, kept)
    };
    let (torques, rows) = run(None);
    assert_eq!(run(Some(&rows)).0, torques);
}

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}

/// Counts allocations in cycles with new targets, changed modes and gains, stale targets, task-set switches, a hold and
/// a resume.
#[test]
fn streamed_targets_allocate_nothing() {
    for shape in ["", LIMITS] {
        let model = seven_joints();
        let axes = r#"{ x = "motion", y = "compliant", z = "motion", ry = "motion" }"#;
        let force = "force = { sensor = 'wrist' }";
        let tracked = |more: &str| {
            let text = hand(axes, &format!("streamed = {{ {shape} }}"), force);
            let rest = "[task.rest.joint-tracking]\nreference.streamed = {}\ngains = { frequency_rad_per_s = 5.0, damping_ratio = 1.0 }\n";
            let damped = text.find("[task.rest").expect("there is one");
            File::read(&format!("{}{rest}", text[..damped].replace("15.0", more)))
        };
        let mut controller = OperationalSpaceController::new(
            &model,
            &tracked("15.0").task_set(),
            &control_context(&model, "hand"),
        )
        .unwrap_or_else(|e| panic!("{e}"));
        let other = controller.prepare(&model, &tracked("25.0").task_set()).unwrap_or_else(|e| panic!("{e}"));
        controller.add_task_set(other).expect("the same inputs");
        let mut bench = Bench::with_controller(model, controller);
        let (home, mut target, mut numbers) = (bench.placement(), bench.hand(), Numbers::new(5));
        let mut rest = JointTarget::of(&bench.targets, "rest").expect("a task");
        for k in 0..900_u32 {
            let q: Vec<f64> = Q.iter().map(|q| q + 0.1 * numbers.next()).collect();
            let translation = home.translation + numbers.vector3(0.05);
            let pose = Target::at_rest(Placement { translation, ..home });
            let modes = [0, 1, 2].map(|_| Some(AxisMode::IN_TASK[numbers.below(3)]));
            let count = allocations(|| {
                if k % 10 == 0 && k % 300 < 100 {
                    let gains = [10.0 + f64::from(k % 20); 6];
                    target.gains(gains, [1.0; 6]).expect("good gains");
                    target.modes([modes[0], modes[1], modes[2], None, None, None]).expect("good modes");
                    write(&mut target, &pose, &mut bench.targets, bench.clock_s);
                    rest.position(&q)
                        .expect("finite")
                        .write(&mut bench.targets, bench.clock_s)
                        .expect("good");
                }
                bench.targets.choose_task_set(k / 50 % 3);
                match k {
                    700..800 => bench.held_cycle(),
                    800 => bench.resume(),
                    _ => bench.cycle(),
                }
            });
            assert_eq!(count, 0, "{shape}: in cycle {k}");
        }
    }
}
