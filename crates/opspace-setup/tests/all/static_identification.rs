//! Compared: stiffness and friction that are identified from the weight of random arms, through their files, and those of the
//! simulation; and the motion of the arms with the plan, their limits and the distances of their links.
//!
//! `OPSPACE_STATIC_SEEDS=1..51` replaces the seeds of the arms, and `--nocapture` prints all estimates.
#![expect(clippy::print_stdout, reason = "estimates, for --nocapture")]

use crate::random_servo_arm::{BACKLASH_RAD, RandomArm};
use opspace_backend::quantity::Positive;
use opspace_backend::{Backend, Capabilities, Command, DeviceFault, Sample};
use opspace_experiment::postures::own_body::{Contacts, OwnBody};
use opspace_experiment::{Progress, RobotDefinition};
use opspace_model::Data;
use opspace_setup::identify::{
    HungWeight, IdentificationJob, IdentificationResults, JointIdentification, Request,
};
use opspace_sim::SimulatedArm;
use std::ops::Range;

/// Largest error of a stiffness.
const STIFFNESS_WITHIN: f64 = 0.05;

/// Largest error of friction where it is compared without its interval.
const FRICTION_WITHIN: f64 = 0.15;

/// Distance by which a joint may pass its planned positions, rad: that within which it is held while another one moves.
const HELD_WITHIN_RAD: f64 = 0.04;

/// Seeds of the arms that were not looked at before the method was complete.
const JUDGED: Range<u64> = 1001..1051;

fn job(arm: &RandomArm, request: Request) -> IdentificationJob {
    IdentificationJob::new(arm.definition(), request).unwrap_or_else(|e| panic!("{e}"))
}

fn run(job: &IdentificationJob) -> IdentificationResults {
    let mut robot = job.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
    job.run(&mut robot, &Progress::default(), |_| {}).unwrap_or_else(|e| panic!("{e}"))
}

fn identify(arm: &RandomArm) -> IdentificationResults {
    run(&job(arm, Request::default()))
}

/// Estimates of a joint that is not refused, and the truth.
struct Estimate {
    name: &'static str,
    error: f64,
    half_width: f64,
    holds: bool,
}

fn estimates(arm: &RandomArm, joint: &JointIdentification) -> [Estimate; 3] {
    let truth = arm.joints[joint.known.joint];
    let servo = joint.found.static_servo.as_ref().expect("a servo");
    [
        ("K", servo.stiffness, servo.stiffness_interval, truth.stiffness),
        ("F", servo.coulomb, servo.coulomb_interval, truth.coulomb),
        ("b", servo.viscous, servo.viscous_interval, truth.viscous),
    ]
    .map(|(name, value, interval, truth)| Estimate {
        name,
        error: value / truth - 1.0,
        half_width: interval.half_width() / truth,
        holds: (interval.lower..=interval.upper).contains(&truth),
    })
}

/// Prints the estimates of an arm. Returns for stiffness, Coulomb and viscous friction if the intervals of all its joints hold.
fn judged(seed: u64, arm: &RandomArm, results: &IdentificationResults) -> [bool; 3] {
    let mut held = [true; 3];
    for joint in &results.joints {
        assert_eq!(joint.no_torque_mode, None, "{seed}, {}", joint.name);
        let all = estimates(arm, joint);
        let text = all.iter().map(|e| {
            let Estimate { name, error, half_width, holds } = e;
            format!(
                "  {name} {:+6.2} % ± {:5.2} %{}",
                100.0 * error,
                100.0 * half_width,
                if *holds { "  " } else { " !" }
            )
        });
        println!("{seed:5} {}{}", joint.name, text.collect::<String>());
        assert!(all[0].error.abs() <= STIFFNESS_WITHIN, "{seed}, {}: {}", joint.name, all[0].error);
        for (held, estimate) in held.iter_mut().zip(&all) {
            *held &= estimate.holds;
        }
    }
    held
}

fn seeds() -> Range<u64> {
    let Ok(text) = std::env::var("OPSPACE_STATIC_SEEDS") else { return JUDGED };
    let (first, end) = text.split_once("..").expect("two numbers");
    first.parse().expect("a number")..end.parse().expect("a number")
}

/// Stiffness within 5 % in all arms, and intervals that hold in nine of ten, in an arm if they do so for all its joints.
#[test]
#[ignore = "takes half a minute: .ci/run"]
fn fifty_random_arms_are_identified() {
    let seeds = seeds();
    let arms = seeds.end - seeds.start;
    let mut held = [0; 3];
    for seed in seeds {
        let arm = RandomArm::new(seed, 1.0);
        let of_arm = judged(seed, &arm, &identify(&arm));
        held.iter_mut().zip(of_arm).for_each(|(held, of_arm)| *held += u64::from(of_arm));
    }
    println!("intervals of stiffness, Coulomb and viscous friction hold in {held:?} of {arms} arms");
    assert!(held.iter().all(|held| 10 * held >= 9 * arms), "{held:?} of {arms}");
}

#[test]
#[ignore = "takes half a minute: .ci/run"]
fn servo_that_is_wrong_by_half_is_refused_in_fifty_random_arms() {
    for seed in seeds() {
        let wrong = if seed % 2 == 0 { 1.5 } else { 1.0 / 1.5 };
        let arm = RandomArm::new(seed, wrong);
        assert_refused(seed, &arm);
    }
}

/// Identifies the joint with the wrong servo alone.
#[track_caller]
fn assert_refused(seed: u64, arm: &RandomArm) {
    let request = Request { joint: Some(RandomArm::WRONG.to_owned()), ..Request::default() };
    let results = run(&job(arm, request));
    let joint = &results.joints[0];
    let refused = joint.no_torque_mode.as_deref().unwrap_or_default();
    assert!(refused.contains("times the declared one"), "{seed}: {refused}");
    // The reason is the stiffness, which is right.
    assert!(estimates(arm, joint)[0].error.abs() <= STIFFNESS_WITHIN, "{seed}");
}

#[test]
fn random_arm_is_identified() {
    let arm = RandomArm::new(501, 1.0);
    judged(501, &arm, &identify(&arm));
}

#[test]
fn servo_that_is_wrong_by_half_is_refused() {
    assert_refused(503, &RandomArm::new(503, 1.5));
    assert_refused(504, &RandomArm::new(504, 1.0 / 1.5));
}

/// Simulated arm, with the largest excursions, the least distance and the largest step of a setpoint noted.
struct Watched<'a> {
    arm: SimulatedArm,
    robot: &'a RobotDefinition,
    own_body: OwnBody,
    data: Data,
    ranges: Vec<[f64; 2]>,
    contacts: Vec<Contacts>,
    last: Vec<f64>,
    largest_step: f64,
}

impl<'a> Watched<'a> {
    fn new(arm: SimulatedArm, robot: &'a RobotDefinition) -> Self {
        Self {
            arm,
            robot,
            own_body: OwnBody::new(&robot.model, &robot.urdf, None, 0.4, 0.0).expect("links that can touch"),
            data: Data::new(&robot.model),
            ranges: vec![[f64::INFINITY, f64::NEG_INFINITY]; robot.model.n()],
            contacts: Vec::new(),
            last: Vec::new(),
            largest_step: 0.0,
        }
    }
}

impl Backend for Watched<'_> {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        for ([least, most], &q) in self.ranges.iter_mut().zip(&sample.q) {
            (*least, *most) = (least.min(q), most.max(q));
        }
        let contacts = self.own_body.contacts(&self.robot.model, &mut self.data, &sample.q, 0.0);
        if contacts != Contacts::default() {
            self.contacts.push(contacts);
        }
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        if let Command::Position(setpoints) = command {
            for (&now, &before) in setpoints.iter().zip(&self.last) {
                self.largest_step = self.largest_step.max((now - before).abs());
            }
            self.last = setpoints.to_vec();
        }
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }
}

#[test]
fn motion_is_the_planned_one_and_free_of_contacts() {
    let seed = 505;
    let arm = RandomArm::new(seed, 1.0);
    let job = job(&arm, Request::default());
    let robot = arm.definition();
    let mut watched = Watched::new(job.simulated_arm().unwrap_or_else(|e| panic!("{e}")), &robot);
    let results = job.run(&mut watched, &Progress::default(), |_| {}).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(watched.contacts, [], "{seed}");
    let sweeps: Vec<_> = results.joints.iter().map(|joint| joint.sweep.as_ref().expect("a plan")).collect();
    for (joint, [least, most]) in watched.ranges.iter().enumerate() {
        let limits = robot.model.joints()[joint].limits;
        assert!(*least > limits.lower && *most < limits.upper, "{seed}, {joint}: {least} to {most}");
        // Its own sweep, and its positions during those of the others.
        let ends = sweeps.iter().map(|sweep| {
            let at = sweep.posture[joint];
            if sweep.joint == joint {
                [sweep.lower, sweep.upper]
            } else {
                [at - HELD_WITHIN_RAD, at + HELD_WITHIN_RAD]
            }
        });
        let start = [-HELD_WITHIN_RAD, HELD_WITHIN_RAD];
        let planned = ends.fold(start, |all, end| [all[0].min(end[0]), all[1].max(end[1])]);
        assert!(*least > planned[0], "{seed}, {joint}: {least} of {planned:?}");
        assert!(*most < planned[1], "{seed}, {joint}: {most} of {planned:?}");
    }
    assert!(watched.largest_step < 0.1, "{seed}: {}", watched.largest_step);
    assert_eq!(job.planned_motions().len(), robot.model.n());
}

/// Compared: the ratio of masses and the stiffness with a hung weight, and those of the simulation, whose masses are not those of the URDF.
#[test]
fn hung_weight_tells_stiffness_from_masses() {
    for (seed, masses) in [(507, 1.0), (508, 1.3)] {
        let arm = RandomArm::new(seed, 1.0).with_masses(masses);
        let mass_kg = Positive::try_from(arm.weight_kg()).expect("a mass");
        let hung_weight = Some(HungWeight { frame: "tip".to_owned(), mass_kg });
        let job = job(&arm, Request { hung_weight, ..Request::default() });
        let mut results = run(&job);
        let mut weighted =
            job.simulated_arm_with_weight().unwrap_or_else(|e| panic!("{e}")).expect("a weight");
        job.run_with_weight(&mut results, &mut weighted, &Progress::default(), |_| {})
            .unwrap_or_else(|e| panic!("{e}"));
        let mut checked = 0;
        for joint in &results.joints {
            // Also where the stiffness was refused before the weight, it is right now.
            assert_eq!(joint.no_torque_mode, None, "{seed}, {}", joint.name);
            assert!(estimates(&arm, joint)[0].error.abs() <= STIFFNESS_WITHIN, "{seed}, {}", joint.name);
            let Some(hung) = joint.found.static_servo.as_ref().and_then(|servo| servo.hung_weight) else {
                continue;
            };
            checked += 1;
            assert!((hung.mass_scale / masses - 1.0).abs() <= STIFFNESS_WITHIN, "{seed}: {hung:?}");
            assert_eq!(hung.agrees(), masses == 1.0, "{seed}: {hung:?}");
        }
        assert!(checked > 0, "{seed}");
    }
}

/// The backlash of the plant is that of the test: the links are displaced by half of it from the encoders.
#[test]
fn identification_is_on_arms_with_backlash() {
    let arm = RandomArm::new(501, 1.0);
    let simulated = arm.definition().file.simulated.expect("a plant");
    let largest = simulated.gear.values().map(|gear| gear.backlash_rad.get()).fold(0.0, f64::max);
    assert!(largest > 0.0 && largest <= BACKLASH_RAD, "{largest}");
}

/// Identified values of an arm, read back from the file that is written.
#[test]
fn written_robot_has_identified_values() {
    let arm = RandomArm::new(509, 1.0);
    let results = identify(&arm);
    let text = results.robot_toml("arm.urdf").unwrap_or_else(|e| panic!("{e}")).expect("a file");
    let written = arm.with_robot(&text).definition();
    let (_, profile) = written.profile(None).unwrap_or_else(|e| panic!("{e}"));
    let servos = written.servos(profile);
    for (joint, servo) in results.joints.iter().zip(&servos) {
        let stiffness = servo.gains(1e-3).stiffness;
        assert!((stiffness / arm.joints[joint.known.joint].stiffness - 1.0).abs() <= STIFFNESS_WITHIN);
        let coulomb = written.joints()[joint.known.joint].friction.coulomb_nm.get();
        assert!((coulomb / arm.joints[joint.known.joint].coulomb - 1.0).abs() <= FRICTION_WITHIN);
    }
}

#[test]
fn integral_action_and_compensated_weight_are_refused_with_the_reason() {
    let arm = RandomArm::new(510, 1.0);
    let refused = |from: &str, to: &str| {
        let changed = arm.with_robot(&arm.robot_toml().replacen(from, to, 1));
        match IdentificationJob::new(changed.definition(), Request::default()) {
            Err(error) => error.to_string(),
            Ok(_) => panic!("accepted: {to}"),
        }
    };
    let integral = refused("pid = { stiff", "pid = { integral_nm_per_rad_s = 1.0, stiff");
    assert!(integral.contains("has integral action"), "{integral}");
    let compensated = refused("\"controller\"", "\"robot\"");
    assert!(compensated.contains("compensates the weight"), "{compensated}");
}
