//! What ends a run, and how: a robot that reports what it shouldn't, on either kind of backend.
//!
//! Compared throughout: what the scripted robot was told, tick by tick, and what the rules of a safe stop say;
//! the robot is the test's own and never moves by itself.

mod common;

use common::{
    Commanded, LIMITS, PERIOD_S, START, Scripted, Ticks, Told, at_rest, facts, model, safety, sensing, servos,
};
use nalgebra::{DVector, Vector3};
use opspace_backend::CommandKind;
use opspace_backend::{GravityBy, Sample};
use opspace_control::{Controller, Measurement};
use opspace_loop::{Backend, Command, ControlLoop, Ending, Fault, PositionBackend, TorqueBackend};
use opspace_model::{Data, Model, frame_placement, update};
use opspace_transformer::{FrictionCompensation, FrictionParameters, PaperTransformer};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

/// Ticks at rest before the controller starts.
const REST: u64 = 10;
/// The tick at which the scripts go wrong, counted from the first read.
const WRONG: u64 = 60;

struct Outcome {
    ending: Ending,
    told: Vec<Told>,
    rows: Vec<Vec<f64>>,
}

fn backend(
    kind: CommandKind,
    model: &Model,
    script: impl FnMut(u64, &mut Sample) + Send + 'static,
) -> (Box<dyn Backend>, Arc<Mutex<Vec<Told>>>) {
    let facts = facts(kind, model);
    let robot = Scripted::new(facts.clone(), script);
    let told = Arc::clone(&robot.told);
    let sensing = sensing(model, facts);
    let backend: Box<dyn Backend> = match kind {
        CommandKind::Torque => Box::new(TorqueBackend::new(robot, sensing)),
        CommandKind::Position => {
            let transformer = Box::new(PaperTransformer::new(servos()));
            Box::new(PositionBackend::new(robot, model, sensing, transformer, &servos(), &LIMITS))
        }
    };
    (backend, told)
}

fn frictionless() -> FrictionCompensation {
    let none: Vec<FrictionParameters> = (0..2)
        .map(|_| {
            common::parsed(
                "coulomb_nm = 0.0\nstatic_nm = 0.0\nstribeck_rad_per_s = 1.0\nviscous_nms_per_rad = 0.0",
            )
        })
        .collect();
    FrictionCompensation::new(none.iter(), &common::parsed(""))
}

/// Runs a controller for 0.2 s.
fn run(
    kind: CommandKind,
    controller: &mut dyn Controller,
    interrupted: bool,
    script: impl FnMut(u64, &mut Sample) + Send + 'static,
) -> Outcome {
    let model = model();
    let (mut backend, told) = backend(kind, &model, script);
    let mut ticks = Ticks::default();
    let mut control = ControlLoop::new(&model, &mut *backend, controller, frictionless(), &LIMITS, safety());
    let ending = control.run(0.2, &AtomicBool::new(interrupted), &mut ticks);
    let told = told.lock().expect("one thread").clone();
    Outcome { ending, told, rows: ticks.0 }
}

/// Holds the arm's weight and adds `extra` (Nm) at both joints.
fn weight_and(extra: f64) -> impl Controller {
    Commanded {
        kind: CommandKind::Torque,
        command: move |data: &Data, _: &Measurement, tau: &mut [f64]| {
            tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + extra);
        },
    }
}

fn gravity_at(q: &[f64]) -> DVector<f64> {
    // By hand: links of 0.5 m, centres halfway, y axis up to down positive in q.
    let (first, second) = (q[0].cos(), (q[0] + q[1]).cos());
    let g = 9.81;
    let fore = 1.0 * g * 0.25 * second;
    DVector::from_vec(vec![-(2.0 * g * 0.25 * first + 1.0 * g * 0.5 * first + fore), -fore])
}

/// The set-point that holds the arm at rest at `q`: the weight over the servo's stiffness away.
fn holding_set_point(q: &[f64]) -> DVector<f64> {
    let g = gravity_at(q);
    DVector::from_vec(vec![q[0] + g[0] / (50.0 * 90.0), q[1] + g[1] / (40.0 * 30.0)])
}

/// A tenth of what one encoder count or one percent of a holding torque would make.
const SET_POINT: f64 = 1e-6;

/// Far below any torque that is held here, Nm.
const TORQUE: f64 = 1e-6;

/// A few operations on numbers of the order of 1.
const ROUNDING: f64 = 1e-12;

fn assert_fault(script: impl Fn(u64, &mut Sample) + Send + Copy + 'static, expected: Fault) {
    for kind in [CommandKind::Position, CommandKind::Torque] {
        let outcome = run(kind, &mut weight_and(0.0), false, script);
        let Ending::Faulted { fault, .. } = outcome.ending else { panic!("{:?}", outcome.ending) };
        // Clock faults hold times; the debug text tells all of it, NaN included.
        assert_eq!(format!("{fault:?}"), format!("{expected:?}"), "{kind:?}");
        check_stop(kind, &outcome, fault);
    }
}

/// After a fault: the safe state, once, and nothing after it; the fault in every row from there on.
fn check_stop(kind: CommandKind, outcome: &Outcome, fault: Fault) {
    let commands = &outcome.told[..outcome.told.len() - 1];
    match (kind, outcome.told.last().expect("it was told")) {
        (CommandKind::Torque, last) => {
            assert_eq!(*last, Told::Brake);
            assert!(!commands.contains(&Told::Brake));
        }
        (CommandKind::Position, Told::Positions(q)) => {
            assert!((q - holding_set_point(&START)).amax() < SET_POINT, "holds where it stood: {q}");
        }
        (_, last) => panic!("{last:?}"),
    }
    let code = f64::from(fault.code());
    let first = outcome.rows.iter().position(|row| row[1] != 0.0).expect("the fault is in a row");
    assert!(outcome.rows[first..].iter().all(|row| row[1] == code), "latched");
    assert!(outcome.rows[first + 1..].iter().all(|row| row[0] == 2.0), "stopped");
    assert_eq!(outcome.rows.len() - first - 1, 200, "0.2 s of aftermath");
    assert_eq!(outcome.rows[first][0], 1.0);
}

#[test]
fn a_measurement_that_is_no_number_stops_the_robot() {
    let script = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        if tick == WRONG {
            sample.q[1] = f64::NAN;
        }
    };
    assert_fault(script, Fault::MeasurementNotFinite { joint: 1 });
    let script = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        let torque = sample.motor_torque.as_mut().expect("measured");
        torque[0] = if tick == WRONG { f64::INFINITY } else { 0.0 };
    };
    assert_fault(script, Fault::MeasurementNotFinite { joint: 0 });
    let script = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        sample.wrenches[0][4] = if tick >= WRONG { f64::NAN } else { 0.0 };
    };
    assert_fault(script, Fault::SensorNotFinite { sensor: 0 });
}

#[test]
fn a_clock_that_stalls_jumps_back_or_is_no_number_stops_the_robot() {
    let before_s = (WRONG - 1) as f64 * PERIOD_S;
    let stalled = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        if tick == WRONG {
            sample.time_s = (WRONG - 1) as f64 * PERIOD_S;
        }
    };
    assert_fault(stalled, Fault::Clock { before_s, now_s: before_s });
    let back = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        if tick == WRONG {
            sample.time_s = 0.001;
        }
    };
    assert_fault(back, Fault::Clock { before_s, now_s: 0.001 });
    let lost = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        if tick == WRONG {
            sample.time_s = f64::NAN;
        }
    };
    assert_fault(lost, Fault::Clock { before_s, now_s: f64::NAN });
}

/// The first reading is as good as none: the robot must not be told to go where nobody saw it.
#[test]
fn a_robot_that_was_never_read_is_told_no_position() {
    let script = |tick, sample: &mut Sample| {
        at_rest(tick, sample);
        sample.q[0] = f64::NAN;
    };
    let outcome = run(CommandKind::Position, &mut weight_and(0.0), false, script);
    assert!(matches!(
        outcome.ending,
        Ending::Faulted { fault: Fault::MeasurementNotFinite { joint: 0 }, .. }
    ));
    assert_eq!(outcome.told, []);
    let outcome = run(CommandKind::Torque, &mut weight_and(0.0), false, script);
    assert_eq!(outcome.told, [Told::Brake]);
}

#[test]
fn a_command_that_is_no_number_never_reaches_the_robot() {
    for kind in [CommandKind::Position, CommandKind::Torque] {
        let mut controller = Commanded {
            kind: CommandKind::Torque,
            command: |data: &Data, measurement: &Measurement, tau: &mut [f64]| {
                tau.copy_from_slice(data.gravity.as_slice());
                if measurement.time_s > 0.05 {
                    tau[1] = f64::NAN;
                }
            },
        };
        let outcome = run(kind, &mut controller, false, at_rest);
        let Ending::Faulted { fault, .. } = outcome.ending else { panic!("{:?}", outcome.ending) };
        assert_eq!(fault, Fault::CommandNotFinite { joint: 1 });
        assert_eq!(
            fault.describe(&model()),
            "joint 'elbow': the controller's command is not a finite number"
        );
        check_stop(kind, &outcome, fault);
        let finite = outcome.told.iter().all(|told| match told {
            Told::Positions(v) | Told::Torques(v) => v.iter().all(|v| v.is_finite()),
            Told::Brake => true,
        });
        assert!(finite);
    }
}

#[test]
fn a_joint_beyond_its_limit_or_too_fast_stops_the_robot() {
    // Drifts slowly beyond 2 rad and its margin of 0.05.
    let drift = |tick: u64, sample: &mut Sample| {
        at_rest(tick, sample);
        sample.q[1] = 1.99 + 1e-3 * tick as f64;
    };
    let outcome = run(CommandKind::Torque, &mut weight_and(0.0), false, drift);
    let Ending::Faulted { fault: Fault::JointLimit { joint, q, lower, upper }, .. } = outcome.ending else {
        panic!("{:?}", outcome.ending)
    };
    assert_eq!((joint, lower, upper), (1, -2.05, 2.05));
    assert!((2.05..2.052).contains(&q), "at the first tick beyond: {q}");

    let fast = |tick: u64, sample: &mut Sample| {
        at_rest(tick, sample);
        sample.q[0] -= 7.0 * PERIOD_S * tick.saturating_sub(WRONG) as f64;
    };
    let outcome = run(CommandKind::Torque, &mut weight_and(0.0), false, fast);
    let Ending::Faulted { fault: Fault::Speed { joint, dq, limit }, .. } = outcome.ending else {
        panic!("{:?}", outcome.ending)
    };
    assert_eq!((joint, limit), (0, 5.0));
    assert!((-7.0..-5.0).contains(&dq), "{dq}");
}

/// A joint that something holds fast while its set-points go on, and set-points that jump.
#[test]
fn a_joint_far_from_its_set_point_stops_the_robot() {
    // (τ_max / kv + v_max) / kp of the elbow, and what it moves in a period.
    let reach = (20.0 / 30.0 + 5.0) / 40.0;
    for (speed, jump) in [(3.0, 0.0), (0.0, 0.5)] {
        let mut controller = Commanded {
            kind: CommandKind::Position,
            command: move |_: &Data, measurement: &Measurement, q: &mut [f64]| {
                q.copy_from_slice(&START);
                q[1] += speed * measurement.time_s + if measurement.time_s > 0.1 { jump } else { 0.0 };
            },
        };
        let outcome = run(CommandKind::Position, &mut controller, false, at_rest);
        let Ending::Faulted { fault, .. } = outcome.ending else { panic!("{:?}", outcome.ending) };
        let Fault::FollowingError { joint, error, limit } = fault else { panic!("{fault:?}") };
        assert_eq!(joint, 1);
        assert!(error > limit && (limit - reach - 5.0 * PERIOD_S).abs() < ROUNDING, "{error} {limit}");
        check_stop(CommandKind::Position, &outcome, fault);
        for told in &outcome.told {
            let Told::Positions(q) = told else { panic!("{told:?}") };
            assert!((q[1] - START[1]).abs() <= limit, "never sent: {q}");
        }
    }
}

/// Beyond any torque limit: the set-point stays where full torque at full speed puts it.
#[test]
fn set_points_are_clamped_about_the_measured_position() {
    let model = model();
    let (mut backend, told) = backend(CommandKind::Position, &model, at_rest);
    let mut data = Data::new(&model);
    backend.read().expect("read");
    backend.sensing_mut().observe(&model, &mut data).expect("observed");
    backend.command(&data, Command::Torque(&[1e6, -1e6])).expect("taken");
    let reach = [(40.0 / 90.0 + 5.0) / 50.0, (20.0 / 30.0 + 5.0) / 40.0];
    let expected = DVector::from_vec(vec![START[0] + reach[0], START[1] - reach[1]]);
    let told = told.lock().expect("one thread");
    let [Told::Positions(q)] = &told[..] else { panic!("{told:?}") };
    assert!((q - expected).amax() < ROUNDING, "{q}");
    let signals = backend.signals();
    let mut row = vec![0.0; signals.iter().map(|s| s.len()).sum()];
    backend.sample(&mut opspace_backend::Row::new(&mut row));
    assert_eq!(signals.last().expect("signals").name, "set_point_clamped");
    assert_eq!(row[row.len() - 2..], [1.0, 1.0]);
}

#[test]
fn a_torque_robot_refuses_positions_by_name() {
    let mut controller = Commanded {
        kind: CommandKind::Position,
        command: |_: &Data, _: &Measurement, q: &mut [f64]| q.copy_from_slice(&START),
    };
    let outcome = run(CommandKind::Torque, &mut controller, false, at_rest);
    assert_eq!(outcome.ending, Ending::Faulted { fault: Fault::WrongCommand, time_s: 0.0 });
    assert_eq!(outcome.told, [Told::Brake]);
    let text = Fault::WrongCommand.describe(&model());
    assert!(text.contains("does not take the commands"), "{text}");
}

#[test]
fn an_interrupt_is_a_safe_stop() {
    for kind in [CommandKind::Position, CommandKind::Torque] {
        let outcome = run(kind, &mut weight_and(0.0), true, at_rest);
        assert_eq!(outcome.ending, Ending::Interrupted { time_s: 0.0 }, "before the controller starts");
        assert!(outcome.rows.iter().all(|row| row[1] == 0.0), "no fault");
        assert_eq!(outcome.rows.last().expect("rows")[0], 2.0);
        match &outcome.told[..] {
            [Told::Brake] => assert_eq!(kind, CommandKind::Torque),
            [Told::Positions(q)] => assert!((q - holding_set_point(&START)).amax() < SET_POINT, "{q}"),
            other => panic!("{other:?}"),
        }
    }
}

/// Compared: what the robot is told over the first 0.15 s, and the weight by hand plus a ramp of 0.1 s.
#[test]
fn every_start_is_a_ramp_from_holding_still() {
    const EXTRA: f64 = 6.0;
    let weight = gravity_at(&START);
    for kind in [CommandKind::Position, CommandKind::Torque] {
        let outcome = run(kind, &mut weight_and(EXTRA), false, at_rest);
        assert_eq!(outcome.ending, Ending::Completed);
        for (k, told) in outcome.told.iter().take(150).enumerate() {
            let share = (k as f64 * PERIOD_S / 0.1).min(1.0);
            let torque = weight.map(|g| g + share * EXTRA);
            match told {
                Told::Torques(tau) => assert!((tau - torque).amax() < TORQUE, "tick {k}: {tau}"),
                Told::Positions(q) => {
                    let expected =
                        [START[0] + torque[0] / (50.0 * 90.0), START[1] + torque[1] / (40.0 * 30.0)];
                    assert!((q[0] - expected[0]).abs() < SET_POINT, "tick {k}: {q}");
                    assert!((q[1] - expected[1]).abs() < SET_POINT, "tick {k}: {q}");
                }
                Told::Brake => panic!("tick {k}"),
            }
        }
    }
}

/// Compared: what is asked at the end, far beyond the limits, and the limits.
#[test]
fn torques_are_clamped_before_they_reach_the_robot() {
    let outcome = run(CommandKind::Torque, &mut weight_and(500.0), false, at_rest);
    let Some(Told::Torques(last)) = outcome.told.iter().rev().find(|t| **t != Told::Brake) else { panic!() };
    assert_eq!(last.as_slice(), LIMITS);
}

/// Compared: a constant reading, whose mean is taken away, and a later pull, turned by the link's pose computed
/// apart.
#[test]
fn force_sensors_are_tared_and_turned_into_world_axes() {
    let model = model();
    let bias = Vector3::new(2.0, -1.0, 0.5);
    let pull = Vector3::new(0.0, 0.0, 4.0);
    let script = move |tick: u64, sample: &mut Sample| {
        at_rest(tick, sample);
        // Noise that has no mean over the rest.
        let noise = if tick.is_multiple_of(2) { 0.1 } else { -0.1 };
        let extra = if tick < REST { Vector3::repeat(noise) } else { pull };
        sample.wrenches[0][..3].copy_from_slice((bias + extra).as_slice());
        sample.wrenches[0][3..].copy_from_slice((0.1 * bias).as_slice());
    };
    let (mut backend, _) = backend(CommandKind::Torque, &model, script);
    let mut data = Data::new(&model);
    for _ in 0..REST {
        backend.read().expect("read");
        backend.sensing_mut().observe(&model, &mut data).expect("observed");
        backend.sensing_mut().tare();
    }
    backend.read().expect("read");
    backend.sensing_mut().observe(&model, &mut data).expect("observed");
    let mut own = Data::new(&model);
    assert!(update(&model, &mut own, &START, &[0.0; 2]));
    let axes = frame_placement(&model, &own, model.frame("fore").expect("a link")).rotation;
    let wrench = backend.sensing().measurement().wrenches[0];
    assert!((wrench.linear - axes * pull).norm() < ROUNDING, "{}", wrench.linear);
    assert!(wrench.angular.norm() < ROUNDING);
    assert!((axes * pull - pull).norm() > 0.1, "the link's axes are not the world's");
}

/// Compared: the stop of a robot that carries its own weight, and where it stands.
#[test]
fn a_position_robot_that_carries_its_weight_stops_where_it_stands() {
    let model = model();
    let facts = opspace_loop::Facts { gravity_by: GravityBy::Robot, ..facts(CommandKind::Position, &model) };
    let robot = Scripted::new(facts.clone(), at_rest);
    let told = Arc::clone(&robot.told);
    let transformer = Box::new(PaperTransformer::new(servos()));
    let mut backend =
        PositionBackend::new(robot, &model, sensing(&model, facts), transformer, &servos(), &LIMITS);
    let mut data = Data::new(&model);
    backend.read().expect("read");
    backend.sensing_mut().observe(&model, &mut data).expect("observed");
    backend.stop(&data);
    assert_eq!(*told.lock().expect("one thread"), [Told::Positions(DVector::from_column_slice(&START))]);
}
