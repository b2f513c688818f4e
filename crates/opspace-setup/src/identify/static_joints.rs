//! Joints whose servos have no velocity loop: plan, measurement and evaluation of a static identification, and its repetition with a
//! hung weight.

use super::{IdentificationJob, IdentificationResults, JointIdentification, Method};
use crate::first_motion::{LEAST_DISTANCE, reach};
use opspace_backend::{Backend, GravityCompensation, Measured, Setpoints};
use opspace_experiment::evaluate::table::Table;
use opspace_experiment::files::source::FileError;
use opspace_experiment::postures::own_body::{Contacts, OwnBody};
use opspace_experiment::postures::tip::tip;
use opspace_experiment::run::execute::Progress;
use opspace_experiment::suggest::choices;
use opspace_identify::session::{AbortReason, ExcitationSession};
use opspace_identify::static_identification::plan::{Bounds, PlanFailure, SweepPlan, plan};
use opspace_identify::static_identification::sweep::{StaticPoint, duration_s, measure};
use opspace_identify::static_identification::{
    Evaluation, LEAST_SPAN, StaticFailure, StaticParameters, add_hung_weight, evaluate, take_stiffness,
};
use opspace_identify::{Identification, Interval95};
use opspace_model::{Data, Inertia, JointKind, Model, Placement};
use opspace_sim::SimulatedArm;
use opspace_sim::parameters::PayloadParameters;
use opspace_transformer::{DerivativeOf, PidServo, ServoParameters};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

/// Name of the hung weight among the frames and payloads.
const WEIGHT: &str = "hung weight";

/// Static identifications by the indices of their joints.
type Evaluations = BTreeMap<usize, Evaluation>;

impl IdentificationJob {
    /// Returns the static method for a servo to which it applies; `None` for other servos.
    ///
    /// # Errors
    /// A servo or an interface that leaves no offset under the weight of the arm.
    pub(super) fn static_method(
        &self,
        servo: &ServoParameters,
        joint: &str,
    ) -> Result<Option<Method>, FileError> {
        let ServoParameters::Pid(pid) = servo else { return Ok(None) };
        let measures_current = self.robot.file.interface.measured.contains(&Measured::MotorCurrent);
        let has_integral = pid.integral_nm_per_rad_s.get() != 0.0;
        // With motor current, a servo with damping shows all its gains.
        if measures_current && pid.damping_nms_per_rad.get() > 0.0 {
            return Ok(None);
        }
        if has_integral {
            let key = ["profile", &self.profile_name, "servo", joint, "pid", "integral_nm_per_rad_s"];
            let message = format!(
                "the servo of joint '{joint}' has integral action: it takes away the offset under the weight of the arm, which shows \
                 its stiffness"
            );
            let help = "set the integral gain to zero, in the servo and here, and identify that servo; the stiffness does not depend \
                        on the integral gain";
            return Err(FileError::at_key(&self.robot.source, key, message, Some(help.to_owned())));
        }
        if self.robot.file.interface.gravity_compensated_by == GravityCompensation::Robot {
            let message = format!(
                "the robot compensates the weight of joint '{joint}' itself: no offset under it shows the stiffness of its servo"
            );
            let help = "take the stiffness from the data sheet, or switch the compensation off and write \
                        gravity_compensated_by = \"controller\"";
            return Err(FileError::at_key(
                &self.robot.source,
                "interface.gravity_compensated_by",
                message,
                Some(help.to_owned()),
            ));
        }
        Ok(Some(Method::Static(*pid)))
    }

    /// Plans the sweeps of the joints that are identified statically.
    ///
    /// # Errors
    /// A weight that hangs on an unknown frame.
    pub(super) fn plan_sweeps(&self) -> Result<Vec<Option<Result<SweepPlan, PlanFailure>>>, FileError> {
        let model = self.weighted_model()?;
        if self.static_joints().next().is_none() {
            return Ok(vec![None; self.joints.len()]);
        }
        let limits = self.robot.torque_limits();
        let mut own_body = OwnLinks::new(self);
        let mut data = Data::new(&self.robot.model);
        let mut contact = |q: &[f64]| own_body.contact(&self.robot.model, &mut data, q);
        let mut sweep = |joint: usize| {
            let bounds = Bounds { model: &model, torque_limits: &limits, contact: &mut contact };
            plan(bounds, &self.start, joint)
        };
        let of = |(&joint, structure): (&usize, &super::Structure)| {
            matches!(structure.method, Method::Static(_)).then(|| sweep(joint))
        };
        Ok(self.joints.iter().zip(&self.structures).map(of).collect())
    }

    /// Indices of the joints that are identified statically, with their servos.
    fn static_joints(&self) -> impl Iterator<Item = (usize, PidServo)> + '_ {
        self.joints.iter().zip(&self.structures).filter_map(|(&joint, structure)| match structure.method {
            Method::Static(servo) => Some((joint, servo)),
            Method::Multisines(_) => None,
        })
    }

    /// Estimated duration of the motions of the joints that are identified statically, s.
    #[must_use]
    pub fn planned_s(&self) -> f64 {
        let plans = self.sweeps.iter().filter_map(|sweep| sweep.as_ref()?.as_ref().ok());
        plans.map(|plan| duration_s(plan, &self.start)).sum()
    }

    /// Planned motions of the joints that are identified statically: joint, and the worst case in words.
    #[must_use]
    pub fn planned_motions(&self) -> Vec<(String, String)> {
        let joints = &self.robot.model.joints();
        let sweeps = self.joints.iter().zip(&self.sweeps);
        let planned = sweeps.filter_map(|(&joint, sweep)| Some((joint, sweep.as_ref()?)));
        let motion = |(joint, sweep): (usize, &Result<SweepPlan, PlanFailure>)| {
            let text = match sweep {
                Err(failure) => failure.to_string(),
                Ok(plan) => {
                    let moved: Vec<String> = (0..joints.len())
                        .filter(|&j| j != joint && plan.posture[j] != self.start[j])
                        .map(|j| format!("{} {:.2}", joints[j].name, plan.posture[j]))
                        .collect();
                    let others = if moved.is_empty() {
                        "the others at the start".to_owned()
                    } else {
                        format!("the others at the start, but {}", moved.join(", "))
                    };
                    format!(
                        "from {:.2} to {:.2} rad at {:.2} rad/s for some {:.0} s, {others}; gravity changes its torque by {:.2} Nm and needs at most \
                         {:.0} % of a torque limit",
                        plan.lower,
                        plan.upper,
                        plan.speed,
                        duration_s(plan, &self.start),
                        plan.gravity_span,
                        100.0 * plan.largest_load
                    )
                }
            };
            (joints[joint].name.clone(), text)
        };
        planned.map(motion).collect()
    }

    /// Model with the hung weight, if there is one.
    fn weighted_model(&self) -> Result<Model, FileError> {
        let mut model = self.robot.model.clone();
        let Some(weight) = &self.hung_weight else { return Ok(model) };
        let frame = model.frame_id(&weight.frame).map_err(|unknown| {
            let message = format!("the robot has no link or tool '{}'", unknown.name);
            FileError::of_file(
                self.robot.source.name(),
                message,
                Some(choices(&unknown.name, &unknown.known)),
            )
        })?;
        let own = model.add_frame_on(WEIGHT, frame, Placement::from_rpy([0.0; 3], [0.0; 3]));
        model.set_payload(own, Inertia { mass: weight.mass_kg.get(), ..Inertia::zero() });
        Ok(model)
    }

    /// Returns the simulated robot with the hung weight, at rest in the start posture; `None` without such a weight.
    ///
    /// # Errors
    /// As [`simulated_arm`](Self::simulated_arm).
    pub fn simulated_arm_with_weight(&self) -> Result<Option<SimulatedArm>, FileError> {
        let Some(weight) = &self.hung_weight else { return Ok(None) };
        let payload = PayloadParameters {
            frame: weight.frame.clone(),
            mass_kg: weight.mass_kg.into(),
            centre_m: [0.0; 3],
        };
        self.simulate(|simulated| drop(simulated.payload.insert(WEIGHT.to_owned(), payload))).map(Some)
    }

    /// Parameters of a joint that are known before its static identification.
    fn static_parameters(&self, joint: usize, servo: &PidServo) -> StaticParameters {
        let drive = &self.robot.joints()[joint];
        // The drive reads positions at its ticks, and holds the torque until the next one.
        let tick_s = self.profile.servo_period_s();
        let lead_s = match self.robot.file.interface.setpoints {
            Setpoints::Held => 0.5 * (self.profile.period_s() + tick_s),
            Setpoints::Interpolated => tick_s,
        };
        let delay_s = f64::from(self.profile.delay()) * tick_s;
        StaticParameters {
            joint,
            limits: (self.robot.model.joints().iter().map(|j| [j.limits.lower, j.limits.upper])).collect(),
            resolution: drive.rotor.resolution_rad(),
            setpoint_resolution: drive.setpoint_resolution_rad.map_or(0.0, |step| step.get()),
            stiffness: servo.stiffness_nm_per_rad.get(),
            lead_s: lead_s - delay_s,
            damping: opposing_damping(servo),
        }
    }

    /// Identifies the static joints, on a robot in the start posture.
    pub(super) fn run_static(
        &self,
        session: &mut ExcitationSession<'_>,
        begun: &mut impl FnMut(&str),
    ) -> Result<Evaluations, AbortReason> {
        let model = &self.robot.model;
        let mut evaluations = Evaluations::new();
        for (joint, servo) in self.static_joints() {
            begun(&model.joints()[joint].name);
            let known = self.static_parameters(joint, &servo);
            let evaluation = match self.measure(session, [model, model], joint, &known) {
                Ok(points) => evaluate(&known, points),
                Err(StaticFailure::Stopped(stop)) if stop.is_final() => return Err(stop),
                Err(reason) => Evaluation { servo: None, refused: Some(reason), doubts: Vec::new() },
            };
            evaluations.insert(joint, evaluation);
        }
        self.share_stiffness(&mut evaluations);
        Ok(evaluations)
    }

    fn measure(
        &self,
        session: &mut ExcitationSession<'_>,
        models: [&Model; 2],
        joint: usize,
        known: &StaticParameters,
    ) -> Result<Vec<StaticPoint>, StaticFailure> {
        let at = self.joints.iter().position(|&other| other == joint);
        match at.and_then(|at| self.sweeps[at].as_ref()) {
            Some(Ok(plan)) => measure(session, models, known, plan, &self.start),
            Some(Err(failure)) => Err(failure.clone().into()),
            None => Err(StaticFailure::DoesNotFollow),
        }
    }

    /// Gives joints on which gravity has too little effect the stiffness of the most exactly identified joint with the same declared
    /// gains.
    fn share_stiffness(&self, evaluations: &mut Evaluations) {
        let servos: BTreeMap<usize, PidServo> = self.static_joints().collect();
        let lacking = |evaluation: &Evaluation| {
            matches!(evaluation.refused, Some(StaticFailure::TooLittleGravity { .. }))
        };
        let takers: Vec<usize> =
            evaluations.iter().filter(|(_, e)| lacking(e)).map(|(&joint, _)| joint).collect();
        let width = |interval: &Interval95| interval.half_width() / (interval.lower + interval.upper);
        for taker in takers {
            let donors = evaluations.iter().filter(|(joint, evaluation)| {
                evaluation.refused.is_none()
                    && evaluation.servo.as_ref().is_some_and(|servo| servo.stiffness_from.is_none())
                    && servos.get(joint) == servos.get(&taker)
            });
            let with_servo = donors.filter_map(|(&joint, e)| Some((joint, e.servo.clone()?)));
            let best = with_servo.min_by(|(_, a), (_, b)| {
                width(&a.stiffness_interval).total_cmp(&width(&b.stiffness_interval))
            });
            let (Some((donor, servo)), Some(evaluation)) = (best, evaluations.get_mut(&taker)) else {
                continue;
            };
            let known = |joint: usize| self.static_parameters(joint, &servos[&joint]);
            take_stiffness(evaluation, &known(taker), &known(donor), &servo);
            let name = &self.robot.model.joints()[donor].name;
            evaluation.doubts.push(format!(
                "gravity changes its torque too little: the ratio of its stiffness to the declared one is that of {name}, which has the \
                 same declared gains"
            ));
        }
    }

    /// Repeats the static identifications on the robot with the hung weight, and compares: `results` are those without it.
    ///
    /// # Errors
    /// The fault of the robot, or the interruption, that ended the identification.
    pub fn run_with_weight(
        &self,
        results: &mut IdentificationResults,
        robot: &mut dyn Backend,
        watch: &Progress,
        mut begun: impl FnMut(&str),
    ) -> Result<(), AbortReason> {
        let ended = |ticks: u64| {
            watch.ticks.store(ticks, Ordering::Relaxed);
            watch.interrupt.load(Ordering::Relaxed)
        };
        let (model, Ok(weighted)) = (&self.robot.model, self.weighted_model()) else { return Ok(()) };
        let kinds: Vec<JointKind> = model.joints().iter().map(|joint| joint.kind).collect();
        let _real_time = self.real_time(robot);
        let mut session = ExcitationSession::begin(robot, &kinds, &ended)?;
        let mut evaluations = std::mem::take(&mut results.evaluations);
        for (joint, servo) in self.static_joints() {
            let Some(evaluation) = evaluations.get_mut(&joint) else { continue };
            let known = self.static_parameters(joint, &servo);
            let Some(servo) = &evaluation.servo else { continue };
            // A stiffness that was taken from another joint is measured, or taken again.
            if servo.stiffness_from.is_some() {
                *evaluation = evaluate(&known, servo.points.clone());
            }
            let at = self.joints.iter().position(|&other| other == joint);
            let sweep = at.and_then(|at| self.sweeps[at].as_ref()?.as_ref().ok());
            let coulomb = evaluation.servo.as_ref().map_or(f64::INFINITY, |servo| servo.coulomb);
            if sweep.is_none_or(|sweep| sweep.gravity_span < LEAST_SPAN * coulomb) {
                continue;
            }
            begun(&model.joints()[joint].name);
            match self.measure(&mut session, [&weighted, model], joint, &known) {
                Ok(points) => add_hung_weight(evaluation, &known, &points),
                Err(StaticFailure::Stopped(stop)) if stop.is_final() => return Err(stop),
                Err(reason) => evaluation.doubts.push(format!("with the hung weight, {reason}")),
            }
        }
        self.share_stiffness(&mut evaluations);
        for joint in &mut results.joints {
            if let Some(evaluation) = evaluations.get(&joint.known.joint) {
                joint.found = Identification::from_static(evaluation.clone());
                joint.no_torque_mode = joint.found.no_torque_mode();
            }
        }
        results.evaluations = evaluations;
        results.robot_s += session.ticks() as f64 * session.period_s();
        Ok(())
    }
}

/// Damping of a servo against its own velocity while its setpoint moves at the same velocity, Nms/rad (Ns/m).
fn opposing_damping(servo: &PidServo) -> f64 {
    let not_fed_forward = match servo.derivative_of {
        DerivativeOf::Position => 1.0 - servo.velocity_feed_forward.get(),
        // The derivative of an error does not oppose a constant velocity.
        DerivativeOf::Error => 0.0,
    };
    not_fed_forward * servo.damping_nms_per_rad.get()
}

impl JointIdentification {
    /// Declared damping of a servo that was identified statically, against its own velocity, Nms/rad (Ns/m).
    pub(super) fn static_damping(&self) -> f64 {
        match self.structure.method {
            Method::Static(servo) => opposing_damping(&servo),
            Method::Multisines(_) => 0.0,
        }
    }
}

/// Contacts of the robot's links with each other and with the floor.
struct OwnLinks {
    own_body: Option<OwnBody>,
    within_m: f64,
}

impl OwnLinks {
    fn new(job: &IdentificationJob) -> Self {
        let robot = &job.robot;
        let reach_m = tip(&robot.model).map_or(1.0, |frame| reach(&robot.model, frame));
        if robot.file.collision.is_some() {
            let own_body = OwnBody::of_robot(robot, reach_m);
            let within_m = own_body.as_ref().map_or(0.0, OwnBody::margin_m);
            return Self { own_body, within_m };
        }
        let within_m = LEAST_DISTANCE * reach_m;
        Self { own_body: OwnBody::new(&robot.model, &robot.urdf, None, reach_m, within_m), within_m }
    }

    /// Returns which links touch in a posture, as a clause.
    fn contact(&mut self, model: &Model, data: &mut Data, q: &[f64]) -> Option<String> {
        let Contacts { links, with_floor, .. } =
            self.own_body.as_mut()?.contacts(model, data, q, self.within_m);
        let of_links = links.map(|[first, second]| format!("{first} and {second} touch"));
        of_links.or_else(|| with_floor.map(|link| format!("{link} touches the floor")))
    }
}

impl IdentificationResults {
    /// Table of the parameters of joints that were identified statically.
    pub(super) fn static_table(joints: &[&JointIdentification]) -> Table {
        let mut table = Table::new(&[
            ("joint", ""),
            ("stiffness", "Nm/rad"),
            ("± 95 %", ""),
            ("with weight", ""),
            ("Coulomb", "Nm"),
            ("± 95 %", ""),
            ("viscous", "Nms/rad"),
            ("gravity", "Nm"),
            ("torque mode", ""),
        ]);
        for joint in joints {
            let servo = joint.found.static_servo.as_ref();
            table.push(vec![
                joint.name.as_str().into(),
                servo.map(|s| s.stiffness).into(),
                servo.map(|s| s.stiffness_interval.half_width()).into(),
                servo.and_then(|s| s.hung_weight).map(|hung| hung.stiffness).into(),
                servo.map(|s| s.coulomb).into(),
                servo.map(|s| s.coulomb_interval.half_width()).into(),
                servo.map(|s| s.viscous).into(),
                servo.map(|s| s.gravity_span).into(),
                joint.acceptance(),
            ]);
        }
        table
    }
}
