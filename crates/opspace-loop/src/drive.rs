//! Drives robots by their runs: read, cycle, write.

use crate::driver_calls::DriverCalls;
use crate::link::Link;
use crate::run::Run;
use crate::timeline::Timeline;
use opspace_backend::{Backend, GroundTruth, Sample};
use opspace_control::HoldCause;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Reads the robot, computes the run's cycle and writes its command, until the run is over. The robot always ends in
/// its safe state: a panic in a task, a controller or the backend also stops it and becomes the run's outcome. So does a
/// real robot whose samples come late by the computer's clock, as [`LATEST_S`](crate::driver_calls::LATEST_S) says.
pub fn drive(backend: &mut dyn Backend, run: &mut Run<'_>) {
    drive_with(backend, run, &mut |_| true);
}

/// Drives a robot as [`drive`] does. `before` is called before each cycle; it may write the targets of the cycle, and
/// returns false if there are no further cycles.
pub fn drive_with(
    backend: &mut dyn Backend,
    run: &mut Run<'_>,
    before: &mut dyn FnMut(&mut Run<'_>) -> bool,
) {
    let mut sample = prepare(backend, run);
    let mut calls = DriverCalls::new(backend.capabilities());
    let cycles = || {
        while !run.is_over() && before(run) {
            cycle(backend, &mut calls, run, &mut sample, &mut |_, _| {});
        }
    };
    if catch_unwind(AssertUnwindSafe(cycles)).is_err() {
        run.abandon();
    }
    stop(backend, run);
}

/// Robot with its run, one of several.
pub struct Driven<'a, 'b> {
    /// Robot's backend.
    pub backend: &'a mut dyn Backend,
    /// Robot's run.
    pub run: &'a mut Run<'b>,
}

/// Drives several robots on one clock, with links between them; their cycles are executed in the order of `timeline`.
/// The robots end in their safe states when all runs are over; a panic of one robot stops all. Cycles that a simulated
/// bus loses are skipped, so that the arms of one simulation are read in the order of their samples.
///
/// # Panics
/// If the timeline or a link refers to a robot that is not in `robots`.
pub fn drive_together(robots: &mut [Driven<'_, '_>], links: &mut [Link], timeline: &mut Timeline) {
    drive_together_with(robots, links, timeline, &mut |_, _, _| true);
}

/// Drives several robots as [`drive_together`] does. `before` is called before each cycle of a run that is not over, with the numbers
/// of the robot and of the cycle; it may write the targets of the cycle, and returns false if there are no
/// further cycles of any robot.
///
/// # Panics
/// As [`drive_together`].
pub fn drive_together_with(
    robots: &mut [Driven<'_, '_>],
    links: &mut [Link],
    timeline: &mut Timeline,
    before: &mut dyn FnMut(usize, u64, &mut Run<'_>) -> bool,
) {
    let mut samples: Vec<Sample> = robots.iter_mut().map(|robot| prepare(robot.backend, robot.run)).collect();
    let mut calls: Vec<DriverCalls> =
        robots.iter().map(|robot| DriverCalls::new(robot.backend.capabilities())).collect();
    let cycles = || {
        while robots.iter().any(|robot| !robot.run.is_over()) {
            let next = timeline.next_cycle();
            let Driven { backend, run } = &mut robots[next.robot];
            if run.is_over() || is_lost(*backend, timeline.number(next)) {
                continue;
            }
            if !before(next.robot, timeline.number(next), run) {
                break;
            }
            let of_driver = &mut calls[next.robot];
            cycle(*backend, of_driver, run, &mut samples[next.robot], &mut |run, clock_s| {
                // What a program asks for is not that of a coupling, which ends when the coupling says so.
                let mut cause = run.targets().hold_cause().filter(|cause| *cause == HoldCause::Requested);
                for link in links.iter_mut().filter(|link| link.to() == next.robot) {
                    let of_link = link.deliver(next.tick, clock_s, run.targets());
                    cause = cause.or(of_link);
                }
                run.targets().hold_because(cause);
            });
            for link in links.iter_mut().filter(|link| link.from() == next.robot) {
                link.send(next.tick, run.row());
            }
        }
    };
    let panicked = catch_unwind(AssertUnwindSafe(cycles)).is_err();
    for Driven { backend, run } in robots {
        if panicked {
            run.abandon();
        }
        stop(*backend, run);
    }
}

/// Stops the robot. A stop that panics is called once more, and becomes the run's outcome.
fn stop(backend: &mut dyn Backend, run: &mut Run<'_>) {
    if let Err(fault) = crate::driver_calls::stop(backend) {
        run.stop_failed(fault);
    }
}

/// Returns true if the robot's simulated bus loses the cycle with that number.
fn is_lost(backend: &dyn Backend, number: u64) -> bool {
    let next = backend.ground_truth().and_then(GroundTruth::next_sample_cycle);
    next.is_some_and(|next| number < next)
}

fn prepare(backend: &mut dyn Backend, run: &mut Run<'_>) -> Sample {
    if let Some(truth) = backend.ground_truth() {
        run.prepare_truth(truth);
    }
    Sample::new(backend.capabilities())
}

/// Runs one cycle. `arrive` is called after the sample is read, with the sample's time on the robot's clock (s); it may
/// write targets. Nothing but the robot's stop is called after a panic of its driver.
fn cycle(
    backend: &mut dyn Backend,
    calls: &mut DriverCalls,
    run: &mut Run<'_>,
    sample: &mut Sample,
    arrive: &mut dyn FnMut(&mut Run<'_>, f64),
) {
    let was_stopped = run.is_stopped();
    let read = calls.read(backend, sample);
    if !calls.panicked()
        && let Some(truth) = backend.ground_truth()
    {
        run.record_truth(truth);
    }
    let command = match read {
        Ok(()) => {
            arrive(run, sample.time_s);
            run.cycle(sample)
        }
        Err(fault) => run.fail(fault),
    };
    if let Some(command) = command
        && !calls.panicked()
    {
        match calls.write(backend, command) {
            Ok(()) => run.command_written(),
            Err(fault) => run.refuse(fault),
        }
    }
    if calls.panicked() {
        run.abandon();
    }
    if run.is_stopped() && !was_stopped {
        stop(backend, run);
    }
    run.between_cycles();
}
