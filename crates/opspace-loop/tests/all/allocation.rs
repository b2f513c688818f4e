//! Tests that no cycle allocates: at rest, in control, after a dropout, held, resuming, at a stop and at a device
//! fault.
//!
//! Compared: the allocator's count before and after each call, for this thread only.

use crate::common::cases::{Case, DURATION_S, cases};
use crate::common::{self, KINDS, PERIOD_S, capabilities, config, gravity_controller, model, parsed};
use opspace_backend::quantity::Positive;
use opspace_backend::{CommandKind, DeviceFault, Layout, Sample, Sink, TICK};
use opspace_loop::{CollisionDetector, ControlLoop, EstimatedForce, Fault, LoopConfig, Phase, Run};
use opspace_testing::allocation::allocations;
use opspace_transformer::{FrictionObserver, FrictionParameters};
use std::sync::atomic::AtomicBool;

/// Sink that keeps the phases and device faults of the rows.
#[derive(Default)]
struct Seen {
    phase: usize,
    device_failed: usize,
    phases: [bool; 5],
    device_fault: bool,
}

impl Seen {
    fn new(layout: &Layout) -> Self {
        let column = |name: &str| {
            let signals = layout.signals.iter().take_while(|signal| signal.name != name);
            signals.map(|signal| signal.len()).sum()
        };
        Self { phase: column("phase"), device_failed: column("device_failed"), ..Self::default() }
    }
}

impl Sink for Seen {
    fn row(&mut self, channel: usize, _time_s: f64, row: &[f64]) {
        if channel == TICK {
            self.phases[row[self.phase] as usize] = true;
            self.device_fault |= row[self.device_failed] == 1.0;
        }
    }
}

fn friction() -> FrictionParameters {
    parsed("coulomb_nm = 1.0\nstatic_nm = 1.0\nstribeck_rad_per_s = 0.1\nviscous_nms_per_rad = 0.5")
}

/// Device fault with a borrowed text.
fn device_fault() -> DeviceFault {
    DeviceFault::new(7, "the drive is too hot")
}

/// Checks that no cycle of a run allocates.
fn check(case: &Case, kind: CommandKind) -> Seen {
    let stop_request = AtomicBool::new(false);
    let fore = model().frame_id("fore").expect("a link");
    let (force, friction) = (parsed("frame = 'fore'"), [friction(), friction()]);
    let parts = LoopConfig {
        friction_observer: Some(FrictionObserver::new(2, Positive::literal(60.0), Positive::literal(6.0))),
        collision: Some(CollisionDetector::new(&parsed("noise_of_limit = 1e3"), &friction, &[40.0, 20.0])),
        estimated_forces: vec![EstimatedForce::new("force", fore, &force, friction.iter())],
        ..config(capabilities(kind), gravity_controller(3.0))
    };
    let control = ControlLoop::new(parts).expect("parts that fit");
    let mut seen = Seen::new(&Run::layouts(&control, None)[TICK]);
    let mut run = Run::new(control, DURATION_S, &mut seen).with_stop_request(&stop_request);
    let mut sample = Sample::new(&capabilities(kind));
    for cycle in 0.. {
        if run.is_over() {
            break;
        }
        let count = allocations(|| {
            let command = if case.unreadable.contains(&cycle) {
                run.fail(device_fault())
            } else {
                case.fill_sample(cycle, &mut sample, &stop_request);
                run.cycle(&sample)
            };
            if command.is_some() && case.refused == Some(cycle) {
                run.refuse(device_fault());
            }
        });
        assert_eq!(count, 0, "{kind:?}, {}, cycle {cycle}", case.name);
    }
    drop(run);
    seen
}

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}

#[test]
fn no_cycle_of_a_run_allocates() {
    for kind in KINDS {
        let mut phases = [false; 5];
        let mut device_fault = false;
        for case in cases() {
            let seen = check(&case, kind);
            (0..5).for_each(|phase| phases[phase] |= seen.phases[phase]);
            device_fault |= seen.device_fault;
        }
        assert!(device_fault && phases[Phase::Rest.code() as usize], "{kind:?}");
        // After a dropout of 20 ms and a hold of 50 ms there is time for a part of the ramp.
        assert_eq!(phases, [true; 5], "{kind:?}: all phases");
    }
}

/// Checks the loop without a run: a robot that rests, drops out, resumes, faults, and is still read.
#[test]
fn no_step_of_a_loop_allocates() {
    for kind in KINDS {
        let mut control =
            ControlLoop::new(config(capabilities(kind), gravity_controller(3.0))).expect("parts that fit");
        let targets = control.targets();
        let mut sample = Sample::new(&capabilities(kind));
        let mut phases = [false; 5];
        for cycle in 0..300_u64 {
            common::at_rest(cycle, &mut sample);
            sample.time_s += if cycle >= 60 { 20.0 * PERIOD_S } else { 0.0 };
            let count = allocations(|| {
                let step = control.step(&sample, &targets);
                phases[step.phase.code() as usize] = true;
                if cycle == 280 {
                    let _ = control.fail(device_fault());
                }
            });
            assert_eq!(count, 0, "{kind:?}, cycle {cycle}");
        }
        assert_eq!(phases, [true; 5], "{kind:?}: all phases");
        let _ = control.stop();
    }
}

/// Checks the detection of a collision and the retraction after it, up to the stop.
#[test]
fn no_cycle_of_a_retraction_allocates() {
    for kind in KINDS {
        let friction = [friction(), friction()];
        let parameters = parsed("reaction = { retract = { distance_rad = 0.1, duration_s = 0.1 } }");
        let mut parts = config(capabilities(kind), gravity_controller(3.0));
        parts.collision = Some(CollisionDetector::new(&parameters, &friction, &[40.0, 20.0]));
        // The arm does not move as its motors do.
        parts.safety.watchdog = parsed("torque_deviation_share = 100.0\nsurplus_power_share = 100.0");
        let mut control = ControlLoop::new(parts).expect("parts that fit");
        let targets = control.targets();
        let mut sample = Sample::new(&capabilities(kind));
        let weight = common::gravity_at(&common::START);
        let mut stopped = None;
        for cycle in 0..600_u64 {
            common::at_rest(cycle, &mut sample);
            if let Some(torque) = &mut sample.motor_torque {
                torque.copy_from_slice(weight.as_slice());
                torque[0] -= if cycle >= 350 { 15.0 } else { 0.0 };
            }
            let count = allocations(|| {
                let step = control.step(&sample, &targets);
                if stopped.is_none() && matches!(step.fault, Some(Fault::Collision { .. })) {
                    stopped = Some(cycle);
                }
            });
            assert_eq!(count, 0, "{kind:?}, cycle {cycle}");
        }
        assert!(stopped.is_some_and(|cycle| cycle > 440), "{kind:?}: stopped in {stopped:?}");
    }
}
