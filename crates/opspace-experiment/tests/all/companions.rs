//! Companions of a run, and the status that a robot reports.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::project;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, GroundTruth, Sample, Status,
};
use opspace_experiment::run::replay::replay;
use opspace_experiment::{
    Companion, CompanionEntry, Experiment, Extensions, Files, Progress, RunOptions, Scenario,
};
use opspace_log::{Recording, ViewerReceiver};
use opspace_loop::{Phase, Run};
use opspace_sim::SimulatedArm;
use std::io::Cursor;
use std::sync::{Arc, Mutex};

/// Calls of companions: number of the companion, and the time of the cycle (s).
type Calls = Arc<Mutex<Vec<(usize, f64)>>>;

/// Companion that notes its calls, asks for a hold from one time on, and ends the run at another (s).
struct Noting {
    number: usize,
    calls: Calls,
    hold_s: f64,
    end_s: f64,
}

impl Companion for Noting {
    fn receivers(&mut self, _robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        Vec::new()
    }

    fn before_cycle(&mut self, _robot: usize, time_s: f64, run: &mut Run<'_>) -> bool {
        self.calls.lock().unwrap().push((self.number, time_s));
        if (time_s - self.hold_s).abs() < 1e-9 {
            run.targets().hold(true);
        }
        time_s < self.end_s
    }
}

/// Simulated arm that reports a status, as drivers of real robots do.
struct Reporting {
    arm: SimulatedArm,
    capabilities: Capabilities,
    cycle: u32,
}

impl Backend for Reporting {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        self.cycle += 1;
        sample.status = Some(Status::new(1000 + self.cycle, self.cycle.is_multiple_of(7)));
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        self.arm.ground_truth()
    }
}

fn experiment() -> Experiment {
    let options =
        RunOptions { backend: CommandKind::Position, duration_s: Some(1.0), ..RunOptions::default() };
    let set = ["task.hand.cartesian.tunable=true".to_owned(), "settle_s=0.1".to_owned()];
    Experiment::load(Files::Disk, &project("tasks/compliant-x.toml"), None, options, &set).unwrap()
}

/// Runs the experiment with companions, and returns its log.
fn run(companions: &mut dyn Companion) -> Recording {
    let own = experiment();
    let scenario = Scenario::from(own.clone());
    let progress = Progress::default();
    let mut arms = scenario.simulated_arms().unwrap();
    let mut robots: Vec<&mut dyn Backend> = arms.iter_mut().map(|arm| arm as &mut dyn Backend).collect();
    let open = |_, capabilities: &Capabilities, truth, receivers| {
        own.open_with(capabilities, truth, Cursor::new(Vec::new()), &progress, receivers)
    };
    let (log, outcome) =
        scenario.drive_robots_with(&mut robots, &progress, companions, open).unwrap().remove(0);
    Recording::from_bytes(&log.close(&own, outcome).unwrap().sink.into_inner()).unwrap()
}

/// Compared: calls of two companions, of which the first ends the run.
#[test]
fn all_companions_are_called_before_each_cycle_until_one_ends_the_run() {
    let calls = Calls::default();
    let noting = |number, end_s| {
        let calls = Arc::clone(&calls);
        Box::new(Noting { number, calls, hold_s: f64::INFINITY, end_s }) as Box<dyn Companion>
    };
    run(&mut vec![noting(0, 0.05), noting(1, f64::INFINITY)]);
    let calls = calls.lock().unwrap();
    let of = |number| calls.iter().filter(|call| call.0 == number).map(|call| call.1).collect::<Vec<_>>();
    assert_eq!(of(0), of(1));
    assert!(
        (of(0).last().unwrap() - 0.05).abs() < 8.0 * f64::EPSILON && of(0).len() == 51,
        "{} calls",
        of(0).len()
    );
}

/// Compared: phases of the log before and after a companion asks once for a hold.
#[test]
fn a_hold_that_a_companion_asks_for_lasts() {
    let calls = Calls::default();
    let mut holding = Noting { number: 0, calls, hold_s: 0.6, end_s: f64::INFINITY };
    let log = run(&mut holding);
    let phases: Vec<f64> = log.tick().unwrap().signal("phase").unwrap().rows().map(|row| row[0]).collect();
    // Cycles of 1 ms.
    assert!(phases[300..600].iter().all(|phase| *phase == Phase::Control.code()));
    assert!(phases[601..1100].iter().all(|phase| *phase == Phase::Held.code()));
    assert_eq!(replay(&experiment(), &log).unwrap().differing, 0);
}

/// Compared: the status of each cycle in the log, and those that the robot reported; all rows, and those of a replay.
#[test]
fn the_status_of_a_robot_is_logged_and_replayed() {
    let own = experiment();
    let arm = own.simulated_arm().unwrap();
    let capabilities = arm.capabilities().clone().with_status();
    let mut robot = Reporting { arm, capabilities, cycle: 0 };
    let sink = own.run_on(&mut robot, Cursor::new(Vec::new()), &Progress::default()).unwrap().sink;
    let log = Recording::from_bytes(&sink.into_inner()).unwrap();
    let tick = log.tick().unwrap();
    let column = |name: &str| tick.signal(name).unwrap().rows().map(|row| row[0]).collect::<Vec<_>>();
    let (words, limited) = (column("status"), column("device_limited"));
    assert!(words.len() > 1000);
    for (cycle, (word, limited)) in (1_u32..).zip(words.iter().zip(&limited)) {
        assert_eq!(
            (*word, *limited),
            (f64::from(1000 + cycle), f64::from(u8::from(cycle.is_multiple_of(7))))
        );
    }
    let report = replay(&own, &log).unwrap();
    assert_eq!((report.differing, report.unmatched.len()), (0, 0));
}

#[test]
fn a_program_opens_its_companions_by_their_entries() {
    let entry = CompanionEntry::new("noting", |scenario, _| {
        let calls = Calls::default();
        let noting = Noting { number: 0, calls, hold_s: f64::INFINITY, end_s: f64::INFINITY };
        Ok((scenario.members.len() == 1).then(|| Box::new(noting) as Box<dyn Companion>))
    });
    let extensions = Extensions::default().with(entry);
    let found = extensions.find::<CompanionEntry>("noting").unwrap();
    assert!(found.open(&Scenario::from(experiment()), &Progress::default()).unwrap().is_some());
    assert!(extensions.find::<CompanionEntry>("notes").is_err());
}
