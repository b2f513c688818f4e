//! Metrics of single tasks: the error of each task against its own reference, contact, and compliance.

use super::axis_metrics::AxisMetrics;
use super::drifts::Drifts;
use super::response::Response;
use super::run_log::{CONTACT_N, Mean, RmsMax, Run, masked_norm};
use super::slack::SlackOfTask;
use super::task_axes::{AxesOfTask, TaskAxes, TaskRow, orientation};
use crate::finding::Finding;
use crate::metrics::metric_tables::{ElementError, TaskMetrics};
use crate::run::experiment::Experiment;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::signal_names::{
    self, CONTACT, ERROR, FORCE, PASSIVITY_TIME, REFERENCE, REFERENCE_ORIENTATION, REFERENCE_VELOCITY,
    TARGET_FORCE, TRUTH_CHANNEL,
};
use opspace_control::orientation::log;
use opspace_control::{AxesFrame, ControlledFrame, TaskParameters};
use opspace_log::Column;
use opspace_model::FrameId;
use std::collections::{BTreeMap, VecDeque};

/// Time for which a task controls a force before it counts as one that never touched, s, if none of it is in the statistics.
const LONG_ENOUGH_S: f64 = 1.0;

/// Largest speed of a reference that rests, m/s.
const RESTING_M_PER_S: f64 = 1e-3;

/// Largest rotation of a reference that rests from one row to the next, rad.
const RESTING_RAD: f64 = 1e-6;

/// Largest force error of settled contact, N, and the time for which it must hold, s.
const SETTLED_N: f64 = 1.0;
const SETTLED_FOR_S: f64 = 0.5;

/// Time before the end whose force error is the final one, s.
const FINAL_S: f64 = 0.5;

/// Time after the first contact in which the largest force is the peak at contact, s.
const PEAK_S: f64 = 1.0;

/// Metrics of all tasks that have a priority at some time of the run, while segments of the log arrive.
pub(super) struct Tasks {
    tasks: Vec<TaskOfRun>,
}

/// A task of the run: its metrics, its errors, and what limits take from it.
struct TaskOfRun {
    name: String,
    metrics: TaskMetrics,
    errors: Option<Errors>,
    slack: SlackOfTask,
}

/// Errors of a task, by its kind.
enum Errors {
    Cartesian(Box<CartesianErrors>),
    Joints(ElementErrors, Option<Vec<String>>),
    /// Errors that the task has logged: those of its own coordinate, as the controller measured them.
    Logged(ElementErrors),
}

impl Errors {
    fn cartesian(experiment: &Experiment, name: &str, frame: &str, controlled: ControlledFrame) -> Self {
        Self::Cartesian(Box::new(CartesianErrors::new(experiment, name, frame, controlled)))
    }
}

impl Tasks {
    pub(super) fn new(experiment: &Experiment) -> Self {
        let model = &experiment.robot().model;
        let tasks = experiment.task().tasks_of_the_run().into_iter().map(|(name, parameters)| {
            let errors = match parameters {
                TaskParameters::Cartesian(task) => (task.controlled_frame(model).ok())
                    .map(|controlled| Errors::cartesian(experiment, name, &task.frame, controlled)),
                TaskParameters::CenterOfMass(_) => {
                    Some(Errors::cartesian(experiment, name, "", ControlledFrame::CenterOfMass))
                }
                TaskParameters::JointTracking(task) => {
                    Some(Errors::Joints(ElementErrors::default(), task.joints.clone()))
                }
                _ => Some(Errors::Logged(ElementErrors::default())),
            };
            let metrics = TaskMetrics { kind: parameters.kind().to_owned(), ..TaskMetrics::default() };
            TaskOfRun { name: name.to_owned(), metrics, errors, slack: SlackOfTask::default() }
        });
        Self { tasks: tasks.collect() }
    }

    pub(super) fn add(&mut self, run: &Run<'_>) {
        for TaskOfRun { name, errors, slack, .. } in &mut self.tasks {
            slack.add(run, name);
            match errors {
                Some(Errors::Cartesian(errors)) => errors.add(run),
                Some(Errors::Joints(errors, joints)) => errors.add_joints(run, name, joints.as_deref()),
                Some(Errors::Logged(errors)) => errors.add_logged(run, name),
                None => {}
            }
        }
    }

    /// Names of the tasks that are to press on something and never touched anything.
    pub(super) fn untouched(&self) -> Vec<String> {
        let is_untouched = |task: &&TaskOfRun| match &task.errors {
            Some(Errors::Cartesian(errors)) => {
                errors.contact.as_ref().is_some_and(ContactForce::never_touched)
            }
            _ => false,
        };
        self.tasks.iter().filter(is_untouched).map(|task| task.name.clone()).collect()
    }

    /// Returns the drifts of compliant axes in a run; the tasks have none then.
    pub(super) fn drifts(&mut self, experiment: &Experiment) -> Vec<Finding> {
        let of_task = |task: &mut TaskOfRun| match &mut task.errors {
            Some(Errors::Cartesian(errors)) => errors.drift(experiment),
            _ => None,
        };
        self.tasks.iter_mut().filter_map(of_task).collect()
    }

    pub(super) fn finish(self) -> BTreeMap<String, TaskMetrics> {
        let finished = self.tasks.into_iter().map(|TaskOfRun { name, mut metrics, errors, slack }| {
            metrics.slack = slack.finish();
            match errors {
                Some(Errors::Cartesian(errors)) => errors.finish(&mut metrics),
                Some(Errors::Joints(errors, _)) => {
                    metrics.elements = errors.finish();
                    let mut squares = Mean::default();
                    let angles = metrics.elements.iter().filter(|element| element.unit == "rad");
                    angles.for_each(|element| squares.add(element.rms.powi(2)));
                    metrics.joint_rms_rad = squares.get().map(f64::sqrt);
                }
                Some(Errors::Logged(errors)) => metrics.elements = errors.finish(),
                None => {}
            }
            (name, metrics)
        });
        finished.collect()
    }
}

/// Errors of elements, each with its name and unit.
#[derive(Default)]
struct ElementErrors {
    elements: Vec<(String, String, RmsMax)>,
}

impl ElementErrors {
    /// Adds the distances of true (otherwise measured) joint positions from the reference of a joint task, for some or
    /// all joints.
    fn add_joints(&mut self, run: &Run<'_>, name: &str, joints: Option<&[String]>) {
        let Some(reference) = run.tick.signal(&signal_names::of(name, REFERENCE)) else { return };
        let (times, q) = run.joints;
        let rows: Vec<(usize, usize)> =
            run.counted(times).filter_map(|k| Some((k, run.tick_of(k)?))).collect();
        let selected = |joint: &str| joints.is_none_or(|joints| joints.iter().any(|name| name == joint));
        for (j, (joint, unit)) in q.elements().iter().zip(q.units()).enumerate() {
            let Some(place) = reference.elements().iter().position(|name| name == joint) else { continue };
            if !selected(joint) {
                continue;
            }
            let sums = self.of(joint, unit);
            let errors = rows.iter().map(|&(k, tick)| (q.row(k)[j] - reference.row(tick)[place]).abs());
            // The reference is absent while the task has no priority.
            errors.filter(|error| error.is_finite()).for_each(|error| sums.add(error));
        }
    }

    /// Adds the errors that a task has logged.
    fn add_logged(&mut self, run: &Run<'_>, name: &str) {
        let Some(error) = run.tick.signal(&signal_names::of(name, ERROR)) else { return };
        for (place, (element, unit)) in error.elements().iter().zip(error.units()).enumerate() {
            let sums = self.of(element, unit);
            let distances = run.counted_ticks().map(|k| error.row(k)[place].abs());
            distances.filter(|distance| distance.is_finite()).for_each(|distance| sums.add(distance));
        }
    }

    fn of(&mut self, name: &str, unit: &str) -> &mut RmsMax {
        let place = self.elements.iter().position(|(known, ..)| known == name).unwrap_or_else(|| {
            self.elements.push((name.to_owned(), unit.to_owned(), RmsMax::default()));
            self.elements.len() - 1
        });
        &mut self.elements[place].2
    }

    fn finish(self) -> Vec<ElementError> {
        let elements = self.elements.into_iter();
        elements
            .filter_map(|(name, unit, sums)| {
                Some(ElementError { name, unit, rms: sums.rms()?, max: sums.max()? })
            })
            .collect()
    }
}

/// Errors, contact and compliance of a Cartesian task.
struct CartesianErrors {
    name: String,
    /// Name of the frame on which forces act; empty for the centre of mass.
    frame: String,
    axes: AxesOfTask,
    position_m: RmsMax,
    orientation_rad: RmsMax,
    single_axes: AxisMetrics,
    /// Errors at the last row, m and rad, if the reference rests there.
    last: [Option<f64>; 2],
    /// Orientation of the reference at the row before.
    reference_before: Option<Matrix3<f64>>,
    contact: Option<ContactForce>,
    compliance: Option<CompliantMotion>,
    drifts: Drifts,
    response: Response,
}

impl CartesianErrors {
    fn new(experiment: &Experiment, name: &str, frame: &str, controlled: ControlledFrame) -> Self {
        Self {
            name: name.to_owned(),
            frame: frame.to_owned(),
            axes: AxesOfTask::new(experiment, name, controlled),
            position_m: RmsMax::default(),
            orientation_rad: RmsMax::default(),
            single_axes: AxisMetrics::default(),
            last: [None; 2],
            reference_before: None,
            contact: None,
            compliance: None,
            drifts: Drifts::default(),
            response: Response::default(),
        }
    }

    fn add<'a>(&mut self, run: &Run<'a>) {
        let signal = |name: &str| run.tick.signal(&signal_names::of(&self.name, name));
        let (reference, reference_orientation) = (signal(REFERENCE), signal(REFERENCE_ORIENTATION));
        let named_forces = run.named_forces_on(&self.frame);
        let forces: Option<Vec<Column<'_>>> =
            named_forces.as_ref().map(|forces| forces.iter().map(|(_, force)| *force).collect());
        let reference_velocity = signal(REFERENCE_VELOCITY);
        let (target, made, passivity) = (signal(TARGET_FORCE), signal(CONTACT), signal(PASSIVITY_TIME));
        let linear_rests = |tick: Option<usize>| {
            logged_row(reference_velocity, tick)
                .is_none_or(|v| Vector3::from_column_slice(v).norm() < RESTING_M_PER_S)
        };
        let settled = run.settled(run.joints.0);
        let settle_s = run.from_s - run.start_s - run.same_s;
        for row in self.axes.rows(run) {
            let TaskRow { k, pose, rotation, in_world, axes } = row;
            let Some(axes) = axes else {
                self.leave();
                self.last = [None; 2];
                continue;
            };
            let is_held = run.is_held(run.joints.0[k]);
            let is_counted = settled.contains(&k) && !is_held;
            if is_held {
                self.last = [None; 2];
            }
            if is_counted {
                self.single_axes.add_position(&row);
            }
            let tick = if is_counted { run.tick_of(k) } else { None };
            let mut linear_error = None;
            if let Some(reference) = logged_row(reference, tick).filter(|_| axes.motion[..3].contains(&true))
            {
                let error = rotation.tr_mul(&(pose.translation - Vector3::from_column_slice(reference)));
                self.single_axes.add_errors(0, &error, &axes.motion);
                linear_error = Some(error);
                let error = masked_norm(&error, &axes.motion[..3]);
                self.position_m.add(error);
                self.last[0] = Some(error).filter(|_| linear_rests(tick));
            }
            if let Some(reference) =
                logged_row(reference_orientation, tick).filter(|_| axes.motion[3..].contains(&true))
            {
                let reference = orientation(reference);
                let error = rotation.tr_mul(&log(&(pose.rotation * reference.transpose())));
                self.single_axes.add_errors(3, &error, &axes.motion);
                let error = masked_norm(&error, &axes.motion[3..]);
                self.orientation_rad.add(error);
                let before = self.reference_before.replace(reference);
                let turn = before.map_or(0.0, |before| log(&(reference * before.transpose())).norm());
                self.last[1] = Some(error).filter(|_| turn < RESTING_RAD);
            }
            let force = forces.as_ref().map(|forces| in_world.tr_mul(&total(forces, k)));
            match force.filter(|_| axes.force.contains(&true)) {
                Some(force) => {
                    let tick = run.tick_up_to(k);
                    let at_tick = |column: Option<Column<'a>>| Some(column?.row(tick?));
                    let (target, made) = (at_tick(target), at_tick(made));
                    let is_resting = at_tick(reference_velocity)
                        .is_none_or(|v| Vector3::from_column_slice(v).norm() < RESTING_M_PER_S);
                    let contact = self.contact.get_or_insert_default();
                    let target = force_target(&axes, target, made);
                    if let Some(made) = made {
                        contact.add_sensed(
                            axes.force.iter().zip(made).any(|(force, made)| *force && *made == 1.0),
                        );
                    }
                    let since_start_s = run.joints.0[k] - run.start_s;
                    let since_s = *contact.controlled_since_s.get_or_insert(since_start_s);
                    contact.presses |= axes.presses;
                    contact.controlled_s = contact.controlled_s.max(since_start_s - since_s);
                    let is_counted = is_counted && since_start_s >= since_s + settle_s;
                    contact.add(&force, &axes.force, target, since_start_s, is_counted, is_resting);
                    contact.reduced_s = passivity
                        .zip(tick)
                        .map(|(time_s, tick)| time_s.row(tick).iter().copied().fold(0.0, f64::max));
                }
                None => self.contact.iter_mut().for_each(ContactForce::leave),
            }
            self.drifts.add(&row, &axes, run.joints.0[k] - run.start_s, named_forces.as_deref());
            let acts = forces.as_ref().is_some_and(|forces| !forces.is_empty());
            if let Some(force) = force.filter(|_| acts && is_counted) {
                let since_start_s = run.joints.0[k] - run.start_s;
                self.response.add(since_start_s, &row, &axes, &force, linear_error.as_ref());
            }
            if axes.compliant.contains(&true) {
                let compliance = self.compliance.get_or_insert_default();
                compliance.add(&row, &axes, force.filter(|_| acts), is_counted);
            } else {
                self.compliance.iter_mut().for_each(CompliantMotion::leave);
            }
        }
    }

    /// Notes that the task has no priority at a row.
    fn leave(&mut self) {
        self.contact.iter_mut().for_each(ContactForce::leave);
        self.compliance.iter_mut().for_each(CompliantMotion::leave);
        self.drifts.leave();
    }

    /// Returns the largest drift of the compliant axes.
    fn drift(&mut self, experiment: &Experiment) -> Option<Finding> {
        std::mem::take(&mut self.drifts).finish(experiment, &self.name)
    }

    fn finish(self, metrics: &mut TaskMetrics) {
        let (position, orientation) = (self.position_m, self.orientation_rad);
        (metrics.pose.position_rms_m, metrics.pose.position_max_m) = (position.rms(), position.max());
        (metrics.pose.orientation_rms_rad, metrics.pose.orientation_max_rad) =
            (orientation.rms(), orientation.max());
        [metrics.pose.position_final_m, metrics.pose.orientation_final_rad] = self.last;
        metrics.axes = self.single_axes.finish();
        metrics.response = self.response.finish(&mut metrics.axes);
        if let Some(contact) = self.contact {
            contact.finish(metrics);
        }
        if let Some(compliance) = self.compliance {
            compliance.finish(metrics);
        }
    }
}

/// Target of the force axes at a row, N: as logged on axes in contact, otherwise as in the file; `None` if it is not known.
pub fn force_target(axes: &TaskAxes, logged: Option<&[f64]>, made: Option<&[f64]>) -> Option<Vector3<f64>> {
    let (Some(logged), Some(made)) = (logged, made) else { return axes.target };
    let mut target = axes.target.unwrap_or_else(|| Vector3::from_column_slice(&logged[..3]));
    for axis in (0..3).filter(|&axis| made[axis] == 1.0) {
        target[axis] = logged[axis];
    }
    Some(target)
}

/// True contact force on a task's frame, compared with the target of its force axes.
#[derive(Default)]
struct ContactForce {
    error_n: RmsMax,
    resting_n: RmsMax,
    moving_n: RmsMax,
    touching: Mean,
    begin_s: Option<f64>,
    /// True if the task was to press on something at some time.
    presses: bool,
    /// Longest time for which the task has controlled a force, s.
    controlled_s: f64,
    /// Time since which the task has controlled a force, s; `None` while it does not.
    controlled_since_s: Option<f64>,
    /// Time since which the error has been small, s.
    small_since_s: Option<f64>,
    settled_s: Option<f64>,
    peak_n: Option<f64>,
    losses: u64,
    late_losses: u64,
    touched: bool,
    /// Number of times that the sensor lost contact, and true while it has contact.
    sensed_losses: u64,
    sensed: bool,
    reduced_s: Option<f64>,
    /// Times (s) and errors (N) of the last [`FINAL_S`].
    last: VecDeque<(f64, f64)>,
}

impl ContactForce {
    /// Adds a force in the axes of the task, of which `axes` are in force control, at a time since the start of control.
    fn add(
        &mut self,
        force: &Vector3<f64>,
        axes: &[bool; 3],
        target: Option<Vector3<f64>>,
        since_start_s: f64,
        is_settled: bool,
        is_resting: bool,
    ) {
        let size = masked_norm(force, axes);
        let touches = size > CONTACT_N;
        if touches && self.begin_s.is_none() {
            self.begin_s = Some(since_start_s);
        }
        let is_early = self.begin_s.is_some_and(|begin_s| since_start_s <= begin_s + PEAK_S);
        if is_early {
            self.peak_n = Some(f64::max(self.peak_n.unwrap_or(0.0), size));
        }
        let is_lost = self.touched && !touches;
        self.losses += u64::from(is_lost);
        self.late_losses += u64::from(is_lost && !is_early);
        self.touched = touches;
        let error_n = target.map(|target| masked_norm(&(force - target), axes));
        self.last.extend(error_n.map(|error_n| (since_start_s, error_n)));
        while self.last.front().is_some_and(|(time_s, _)| *time_s < since_start_s - FINAL_S) {
            self.last.pop_front();
        }
        if let (Some(error_n), Some(begin_s), None) = (error_n, self.begin_s, self.settled_s) {
            if error_n > SETTLED_N {
                self.small_since_s = None;
            } else {
                let since_s = *self.small_since_s.get_or_insert(since_start_s);
                self.settled_s = (since_start_s - since_s >= SETTLED_FOR_S).then_some(since_s - begin_s);
            }
        }
        if is_settled {
            if let Some(error_n) = error_n {
                self.error_n.add(error_n);
                let part = if is_resting { &mut self.resting_n } else { &mut self.moving_n };
                part.add(error_n);
            }
            self.touching.add(f64::from(u8::from(touches)));
        }
    }

    /// True if the task was to press on something and never touched anything, in the statistics or for long enough.
    fn never_touched(&self) -> bool {
        let is_long = self.touching.get().is_some() || self.controlled_s >= LONG_ENOUGH_S;
        self.presses && self.begin_s.is_none() && is_long
    }

    /// Adds whether the task has contact according to its sensor.
    fn add_sensed(&mut self, has_contact: bool) {
        self.sensed_losses += u64::from(self.sensed && !has_contact);
        self.sensed = has_contact;
    }

    /// Notes that the task controls no force: contact that ends until it does again is not lost, and the force settles anew.
    fn leave(&mut self) {
        self.touched = false;
        self.sensed = false;
        self.last.clear();
        self.controlled_since_s = None;
    }

    fn finish(self, metrics: &mut TaskMetrics) {
        let contact = &mut metrics.contact;
        (contact.force_rms_n, contact.force_hold_rms_n) = (self.error_n.rms(), self.resting_n.rms());
        contact.force_error_max_n = self.error_n.max();
        contact.force_moving_rms_n = self.moving_n.rms();
        contact.force_settle_s = self.settled_s;
        let mut last = RmsMax::default();
        self.last.iter().for_each(|(_, error_n)| last.add(*error_n));
        contact.force_final_n = last.rms();
        contact.in_contact_fraction = self.touching.get();
        (contact.contact_begin_s, contact.contact_peak_n) = (self.begin_s, self.peak_n);
        contact.contact_losses = Some(self.losses);
        contact.late_contact_losses = Some(self.late_losses);
        contact.sensed_contact_losses = Some(self.sensed_losses);
        contact.passivity_active_s = self.reduced_s;
    }
}

/// Motion of a task's frame along its compliant axes, and the work done on it there.
#[derive(Default)]
struct CompliantMotion {
    /// Position at which each axis became compliant, m; `None` while it is not.
    starts: [Option<Vector3<f64>>; 3],
    /// Frame of the axes at the row before.
    directions: Option<AxesFrame>,
    moved_m: RmsMax,
    work_j: Option<f64>,
    /// Settled row before.
    before: Option<RowBefore>,
}

/// Row of a compliant motion, for the work until the next one.
struct RowBefore {
    position_m: Vector3<f64>,
    axes: Matrix3<f64>,
    /// Force in these axes, N.
    force_n: Vector3<f64>,
}

impl CompliantMotion {
    /// Adds a row, the axes of the task there, and the true force in these axes if it is known.
    fn add(&mut self, row: &TaskRow, axes: &TaskAxes, force: Option<Vector3<f64>>, is_settled: bool) {
        // Axes in other directions are other axes.
        if self.directions.replace(axes.directions).is_some_and(|before| before != axes.directions) {
            self.leave();
        }
        let position_m = row.pose.translation;
        let was_compliant = self.starts.map(|start| start.is_some());
        for (start, compliant) in self.starts.iter_mut().zip(axes.compliant) {
            *start = compliant.then(|| start.unwrap_or(position_m));
        }
        if !is_settled {
            return;
        }
        let moved = [0, 1, 2].map(|axis| {
            self.starts[axis].map_or(0.0, |start| row.rotation.tr_mul(&(position_m - start))[axis])
        });
        self.moved_m.add(Vector3::from(moved).norm());
        let Some(force_n) = force else { return };
        let mut work_j = self.work_j.unwrap_or(0.0);
        if let Some(RowBefore { position_m: before_m, axes: directions, force_n }) = &self.before {
            let step = directions.tr_mul(&(position_m - before_m));
            let counted = (0..3).filter(|&axis| was_compliant[axis] && axes.compliant[axis]);
            work_j += counted.map(|axis| force_n[axis] * step[axis]).sum::<f64>();
        }
        self.work_j = Some(work_j);
        self.before = Some(RowBefore { position_m, axes: row.rotation, force_n });
    }

    /// Notes that the task has no compliant axis: it has neither displacement nor work until it has one again.
    fn leave(&mut self) {
        self.starts = [None; 3];
        self.before = None;
    }

    fn finish(self, metrics: &mut TaskMetrics) {
        metrics.compliance.compliant_motion_rms_m = self.moved_m.rms();
        metrics.compliance.compliant_work_j = self.work_j;
    }
}

impl Run<'_> {
    /// True forces of the objects of the environment that act on the body of a frame; `None` if the log has no true
    /// state.
    pub fn forces_on(&self, frame: &str) -> Option<Vec<Column<'_>>> {
        Some(self.named_forces_on(frame)?.into_iter().map(|(_, force)| force).collect())
    }

    /// True forces of the objects of the environment that act on the body of a frame, with the names of the objects; `None` if
    /// the log has no true state.
    pub(crate) fn named_forces_on(&self, frame: &str) -> Option<Vec<(&str, Column<'_>)>> {
        let model = &self.experiment.robot().model;
        let body = |name: &str| model.frame_id(name).ok().map(|id: FrameId| model.frame(id).body);
        let truth = self.recording.channel(TRUTH_CHANNEL)?;
        let objects = self.experiment.task().file.environment.iter();
        let on_body = objects.filter(|(_, object)| body(object.frame()) == body(frame));
        let force = |name: &str| truth.signal(&signal_names::of(name, FORCE));
        Some(on_body.filter_map(|(name, _)| Some((name.as_str(), force(name)?))).collect())
    }
}

/// Row of a signal, if it is there and finite.
fn logged_row<'a>(column: Option<Column<'a>>, k: Option<usize>) -> Option<&'a [f64]> {
    Some(column?.row(k?)).filter(|row| row.iter().all(|value| value.is_finite()))
}

/// Sum of the forces in row `k`, world axes.
pub fn total(forces: &[Column<'_>], k: usize) -> Vector3<f64> {
    forces.iter().map(|force| Vector3::from_column_slice(force.row(k))).sum()
}
