//! Interface cycles that are missed, and watchdogs, on a robot that does as the test says.
//!
//! Compared throughout: what the scripted robot was told, tick by tick, and what the rules of holding and resuming say.

mod common;

use common::{
    Commanded, LIMITS, PERIOD_S, START, Scripted, Ticks, Told, at_rest, facts, model, parsed, safety,
    sensing, servos,
};
use nalgebra::DVector;
use opspace_backend::CommandKind;
use opspace_backend::Sample;
use opspace_control::{Controller, Measurement};
use opspace_loop::{Backend, ControlLoop, Ending, Fault, Phase, PositionBackend, TorqueBackend};
use opspace_model::Data;
use opspace_transformer::{FrictionCompensation, FrictionParameters, PaperTransformer};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

/// Ticks at rest before the controller starts.
/// Of sums of times and positions of order 1, s and rad/s.
const ROUNDING: f64 = 1e-9;

const REST: u64 = 10;
/// The read before which cycles are missed, counted from the first.
const AFTER: u64 = 60;
/// How long a robot must stand still before it is commanded again, in ticks.
const STILL: usize = 50;
/// How long torques come in, in ticks.
const RAMP: usize = 100;
/// Far below any torque that is asked for here, Nm.
const TORQUE: f64 = 1e-9;

const KINDS: [CommandKind; 2] = [CommandKind::Position, CommandKind::Torque];

struct Outcome {
    ending: Ending,
    told: Vec<Told>,
    rows: Vec<Vec<f64>>,
}

impl Outcome {
    fn phases(&self) -> Vec<f64> {
        self.rows.iter().map(|row| row[0]).collect()
    }

    fn fault(&self) -> Fault {
        let Ending::Faulted { fault, .. } = self.ending else { panic!("{:?}", self.ending) };
        fault
    }
}

fn run(
    kind: CommandKind,
    controller: &mut dyn Controller,
    duration_s: f64,
    script: impl FnMut(u64, &mut Sample) + Send + 'static,
) -> Outcome {
    let model = model();
    let facts = facts(kind, &model);
    let robot = Scripted::new(facts.clone(), script);
    let told = Arc::clone(&robot.told);
    let sensing = sensing(&model, facts);
    let mut backend: Box<dyn Backend> = match kind {
        CommandKind::Torque => Box::new(TorqueBackend::new(robot, sensing)),
        CommandKind::Position => {
            let transformer = Box::new(PaperTransformer::new(servos()));
            Box::new(PositionBackend::new(robot, &model, sensing, transformer, &servos(), &LIMITS))
        }
    };
    let none: [FrictionParameters; 2] = [(); 2].map(|()| {
        parsed("coulomb_nm = 0.0\nstatic_nm = 0.0\nstribeck_rad_per_s = 1.0\nviscous_nms_per_rad = 0.0")
    });
    let friction = FrictionCompensation::new(none.iter(), &parsed(""));
    let mut ticks = Ticks::default();
    let mut control = ControlLoop::new(&model, &mut *backend, controller, friction, &LIMITS, safety());
    let ending = control.run(duration_s, &AtomicBool::new(false), &mut ticks);
    let told: Vec<Told> = Mutex::lock(&told).expect("one thread").clone();
    Outcome { ending, told, rows: ticks.0 }
}

/// The clock of a robot of which `missed` cycles are missed before read [`AFTER`].
fn late(tick: u64, missed: u64) -> f64 {
    (tick + if tick >= AFTER { missed } else { 0 }) as f64 * PERIOD_S
}

/// At rest all the while, with that many cycles missed.
fn silent(missed: u64) -> impl FnMut(u64, &mut Sample) + Send + Copy {
    move |tick, sample| {
        at_rest(tick, sample);
        sample.time_s = late(tick, missed);
    }
}

fn weight_and(extra: f64) -> impl Controller {
    Commanded {
        kind: CommandKind::Torque,
        command: move |data: &Data, _: &Measurement, tau: &mut [f64]| {
            tau.iter_mut().zip(&data.gravity).for_each(|(tau, g)| *tau = g + extra);
        },
    }
}

/// Compared: the velocity that the controller sees of a joint that moves steadily, and that speed; the run's ticks and
/// missed cycles, and the periods that it was to last.
#[test]
fn a_few_missed_cycles_are_bridged() {
    const SPEED: f64 = 1.3;
    for missed in 1..=3 {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&seen);
        let mut controller = Commanded {
            kind: CommandKind::Torque,
            command: move |data: &Data, measurement: &Measurement, tau: &mut [f64]| {
                tau.copy_from_slice(data.gravity.as_slice());
                sink.lock().expect("one thread").push((measurement.time_s, measurement.dq[0]));
            },
        };
        let outcome = run(CommandKind::Torque, &mut controller, 0.2, move |tick, sample| {
            at_rest(tick, sample);
            sample.time_s = late(tick, missed);
            sample.q[0] += SPEED * sample.time_s;
        });
        assert_eq!(outcome.ending, Ending::Completed);
        assert!(outcome.phases()[REST as usize..].iter().all(|p| *p == Phase::Control.code()));
        let seen = seen.lock().expect("one thread");
        // The filter of 150 Hz began at zero: what is left of that after 40 ms is e^-38.
        let settled = seen.iter().filter(|(time_s, _)| *time_s > 0.04);
        settled
            .for_each(|(time_s, dq)| assert!((dq - SPEED).abs() < ROUNDING, "{missed}: {dq} at {time_s} s"));
        assert_eq!(seen.len() as u64 + missed, 200, "as long as it was to last");
        let last_s = seen.last().expect("ticks").0;
        assert!((last_s - 0.199).abs() < ROUNDING, "{last_s} s");
    }
}

/// Compared: what the robot is told after a dropout of 0.1 s, and first what held it, then the weight plus a ramp; and
/// the phases of the ticks.
#[test]
fn after_a_dropout_the_robot_is_held_and_torques_come_in_again() {
    const EXTRA: f64 = 6.0;
    const BEFORE: usize = (AFTER - REST) as usize;
    for kind in KINDS {
        let outcome = run(kind, &mut weight_and(EXTRA), 0.5, silent(100));
        assert_eq!(outcome.ending, Ending::Completed);
        let held = &outcome.told[BEFORE..BEFORE + STILL];
        match kind {
            CommandKind::Torque => assert!(held.iter().all(|told| *told == Told::Brake)),
            CommandKind::Position => assert!(held.iter().all(|told| *told == outcome.told[BEFORE - 1])),
        }
        let torques = |told: &Told| match told {
            Told::Torques(tau) => tau.clone(),
            Told::Positions(q) => {
                DVector::from_vec(vec![(q[0] - START[0]) * 50.0 * 90.0, (q[1] - START[1]) * 40.0 * 30.0])
            }
            Told::Brake => panic!("it is commanded again"),
        };
        let start = torques(&outcome.told[0]);
        for (k, told) in outcome.told[BEFORE + STILL..].iter().enumerate().take(2 * RAMP) {
            let share = (k as f64 / RAMP as f64).min(1.0);
            let error = torques(told) - start.add_scalar(share * EXTRA);
            assert!(error.amax() < TORQUE, "{kind:?}, tick {k}: off by {error}");
        }
        let phases = &outcome.phases()[AFTER as usize..];
        let lasts = |phase: Phase| phases.iter().filter(|p| **p == phase.code()).count();
        assert_eq!((lasts(Phase::Held), lasts(Phase::Resuming)), (STILL, RAMP));
        assert_eq!(phases[0], Phase::Held.code());
        assert_eq!(phases[STILL], Phase::Resuming.code());
        assert_eq!(phases[STILL + RAMP], Phase::Control.code());
    }
}

/// Compared: the ticks for which a robot that still moves is held, and those of one that stands.
#[test]
fn a_robot_that_still_moves_is_held_until_it_stands() {
    let moves_on = |until: u64| {
        move |tick: u64, sample: &mut Sample| {
            at_rest(tick, sample);
            sample.time_s = late(tick, 10);
            sample.q[1] += 0.1 * PERIOD_S * (tick.min(until) as f64 - AFTER as f64).max(0.0);
        }
    };
    for kind in KINDS {
        let outcome = run(kind, &mut weight_and(0.0), 0.5, moves_on(AFTER + 120));
        assert_eq!(outcome.ending, Ending::Completed);
        let held = outcome.phases().iter().filter(|p| **p == Phase::Held.code()).count();
        // Looked at every 50 ms: the third time it has moved, the fourth not.
        assert_eq!(held, 4 * STILL, "{kind:?}");

        let outcome = run(kind, &mut weight_and(0.0), 3.0, moves_on(u64::MAX));
        let Fault::NotHeld { joint: 1, held_s } = outcome.fault() else { panic!("{:?}", outcome.ending) };
        assert!((1.0..1.06).contains(&held_s), "{held_s} s");
        assert!(outcome.fault().describe(&model()).contains("joint 'elbow'"));
    }
}

/// Compared: the last of what the robot is told, and its safe state.
#[test]
fn a_robot_that_is_silent_for_too_long_is_stopped() {
    for kind in KINDS {
        let outcome = run(kind, &mut weight_and(3.0), 3.0, silent(1001));
        let Fault::Dropout { silent_s, longest_s } = outcome.fault() else { panic!("{:?}", outcome.ending) };
        assert!((silent_s - 1.001).abs() < 1e-9 && longest_s == 1.0, "{silent_s} s, {longest_s} s");
        let first = &outcome.told[0];
        match outcome.told.last().expect("it was told") {
            Told::Brake => assert_eq!(kind, CommandKind::Torque),
            // The first was made for the weight alone.
            last @ Told::Positions(_) => assert_eq!(last, first, "it holds where it stands"),
            other => panic!("{other:?}"),
        }
        assert_eq!(run(kind, &mut weight_and(3.0), 3.0, silent(1000)).ending, Ending::Completed);
    }
}

/// After a dropout the old state is no place to go back to, and if the new one is none, nothing is sent.
#[test]
fn a_state_that_can_not_be_trusted_moves_no_set_point() {
    let outcome = run(CommandKind::Position, &mut weight_and(3.0), 0.5, |tick, sample| {
        at_rest(tick, sample);
        sample.time_s = late(tick, 100);
        sample.q[0] = if tick >= AFTER { f64::NAN } else { sample.q[0] };
    });
    assert!(matches!(outcome.fault(), Fault::MeasurementNotFinite { joint: 0 }));
    assert_eq!(outcome.told.len() as u64, AFTER - REST, "nothing after the dropout");

    // An encoder that slips by a radian: what it said before is where the robot is held.
    for kind in KINDS {
        let outcome = run(kind, &mut weight_and(0.0), 0.5, |tick, sample| {
            at_rest(tick, sample);
            sample.q[0] += if tick >= AFTER { 1.0 } else { 0.0 };
        });
        let Fault::PositionSlip { joint: 0, step, limit } = outcome.fault() else {
            panic!("{:?}", outcome.ending)
        };
        // Twice the 5 rad/s of its limit, and a milliradian.
        assert!((step - 1.0).abs() < 1e-12 && (limit - 0.011).abs() < 1e-12, "{step} {limit}");
        match outcome.told.last().expect("it was told") {
            Told::Brake => assert_eq!(kind, CommandKind::Torque),
            last => assert_eq!(last, &outcome.told[0]),
        }
    }
}

/// A motor that gives what is asked for and `more` of it (Nm), of a joint that moves at `speed`.
fn pushed(more: f64, speed: f64, weight: Arc<Mutex<DVector<f64>>>) -> impl FnMut(u64, &mut Sample) + Send {
    move |tick, sample| {
        at_rest(tick, sample);
        sample.q[1] += speed * PERIOD_S * (tick as f64 - AFTER as f64).max(0.0);
        let torque = sample.motor_torque.as_mut().expect("measured");
        torque.copy_from_slice(weight.lock().expect("one thread").as_slice());
        torque[1] += if tick >= AFTER { more } else { 0.0 };
    }
}

/// Compared: which fault, and when, for torques below and above the bounds, with the means' own time constant.
#[test]
fn motors_that_do_not_do_what_is_asked_of_them_stop_the_robot() {
    let watch = |kind: CommandKind, more: f64, speed: f64| {
        let weight = Arc::new(Mutex::new(DVector::zeros(2)));
        let asked = Arc::clone(&weight);
        let mut controller = Commanded {
            kind: CommandKind::Torque,
            command: move |data: &Data, _: &Measurement, tau: &mut [f64]| {
                tau.copy_from_slice(data.gravity.as_slice());
                asked.lock().expect("one thread").copy_from(&data.gravity);
            },
        };
        run(kind, &mut controller, 0.3, pushed(more, speed, weight))
    };
    let after_s = |outcome: &Outcome| match outcome.ending {
        Ending::Faulted { time_s, .. } => time_s - (AFTER - REST) as f64 * PERIOD_S,
        _ => panic!("{:?}", outcome.ending),
    };
    // 0.6 of the elbow's 20 Nm: 14 Nm are beyond it after 50 ms times ln(1/(1 - 12/14)).
    let outcome = watch(CommandKind::Position, 14.0, 0.0);
    let Fault::TorqueDeviation { joint: 1, limit, .. } = outcome.fault() else {
        panic!("{:?}", outcome.ending)
    };
    assert!((limit - 12.0).abs() < 1e-12, "{limit}");
    let expected_s = 0.05 * (1.0_f64 / (1.0 - 12.0 / 14.0)).ln();
    assert!((after_s(&outcome) - expected_s).abs() <= 2.0 * PERIOD_S, "{} s", after_s(&outcome));
    assert_eq!(watch(CommandKind::Position, 11.9, 0.0).ending, Ending::Completed);

    // 0.05 of 20 Nm times 5 rad/s: 10 Nm at 1 rad/s are twice that.
    let outcome = watch(CommandKind::Position, 10.0, 1.0);
    let Fault::SurplusPower { joint: 1, limit, .. } = outcome.fault() else { panic!("{:?}", outcome.ending) };
    assert!((limit - 5.0).abs() < 1e-12, "{limit}");
    // 50 ms times ln 2, and what the velocity's filter takes.
    assert!((after_s(&outcome) - 0.05 * 2.0_f64.ln()).abs() < 4.0 * PERIOD_S, "{} s", after_s(&outcome));
    // What brakes is no danger.
    assert_eq!(watch(CommandKind::Position, -10.0, 0.3).ending, Ending::Completed);
    // A torque robot's own drives see to it.
    assert_eq!(watch(CommandKind::Torque, 14.0, 0.0).ending, Ending::Completed);
}
