//! Metrics of single tasks: the error of each task against its own reference, contact, and compliance.

use super::run_log::{Run, masked_norm, mean, rms_and_max};
use crate::evaluate::metric_tables::{ElementError, TaskMetrics};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use opspace_backend::signal_names::{self, ERROR, FORCE, REFERENCE, REFERENCE_ORIENTATION, TRUTH_CHANNEL};
use opspace_control::orientation::log;
use opspace_control::{AxisMode, CartesianParameters, CartesianReference, ControlledFrame, TaskParameters};
use opspace_log::Column;
use opspace_model::{FrameId, Placement};
use std::collections::BTreeMap;
use std::ops::Range;

/// Smallest true contact force that counts as contact, N.
const CONTACT_N: f64 = 0.1;

/// Time after the first contact in which the largest force is the peak at contact, s.
const PEAK_S: f64 = 1.0;

impl Run<'_> {
    /// Computes the metrics of all tasks that have a priority at the start.
    pub(crate) fn tasks(&self) -> BTreeMap<String, TaskMetrics> {
        let file = &self.experiment.task().file;
        let mut all = BTreeMap::new();
        for (name, parameters) in file.task.iter().filter(|(name, _)| file.priority.contains(name)) {
            let mut metrics = TaskMetrics { kind: parameters.kind().to_owned(), ..TaskMetrics::default() };
            match parameters {
                TaskParameters::Cartesian(task) => {
                    if let Ok(controlled) = task.controlled_frame(&self.experiment.robot().model) {
                        self.pose_errors(name, task, controlled, &mut metrics);
                        self.contact(task, controlled, &mut metrics);
                        self.compliance(task, controlled, &mut metrics);
                    }
                }
                TaskParameters::CenterOfMass(task) => {
                    let (task, controlled) = (task.as_cartesian(), ControlledFrame::CenterOfMass);
                    self.pose_errors(name, &task, controlled, &mut metrics);
                }
                TaskParameters::JointTracking(task) => {
                    metrics.elements = self.joint_errors(name, task.joints.as_deref());
                    let angles = metrics.elements.iter().filter(|element| element.unit == "rad");
                    metrics.joint_rms_rad = mean(angles.map(|element| element.rms.powi(2))).map(f64::sqrt);
                }
                _ => metrics.elements = self.logged_errors(name),
            }
            all.insert(name.clone(), metrics);
        }
        all
    }

    /// Computes the distance and the angle of a task's controlled frame from its reference, along the motion axes.
    fn pose_errors(
        &self,
        name: &str,
        task: &CartesianParameters,
        subject: ControlledFrame,
        metrics: &mut TaskMetrics,
    ) {
        let Ok(directions) = task.axes_frame.resolve(&self.experiment.robot().model, subject) else { return };
        let motion = task.motion_axes();
        if let Some(reference) = self.tick.signal(&signal_names::of(name, REFERENCE))
            && motion[..3].contains(&true)
        {
            let errors = self.poses(subject, directions).filter_map(|(k, pose, axes)| {
                let error = pose.translation - Vector3::from_column_slice(reference.row(self.tick_of(k)?));
                Some(masked_norm(&axes.tr_mul(&error), &motion[..3]))
            });
            (metrics.pose.position_rms_m, metrics.pose.position_max_m) = rms_and_max(errors);
        }
        if let Some(reference) = self.tick.signal(&signal_names::of(name, REFERENCE_ORIENTATION))
            && motion[3..].contains(&true)
        {
            let errors = self.poses(subject, directions).filter_map(|(k, pose, axes)| {
                let reference = orientation(reference.row(self.tick_of(k)?));
                let error = log(&(pose.rotation * reference.transpose()));
                Some(masked_norm(&axes.tr_mul(&error), &motion[3..]))
            });
            (metrics.pose.orientation_rms_rad, metrics.pose.orientation_max_rad) = rms_and_max(errors);
        }
    }

    /// Compares true (otherwise measured) joint positions with the reference of a joint task, for some or all joints.
    pub(crate) fn joint_errors(&self, name: &str, joints: Option<&[String]>) -> Vec<ElementError> {
        let Some(reference) = self.tick.signal(&signal_names::of(name, REFERENCE)) else { return Vec::new() };
        let (times, q) = self.joints;
        let rows: Vec<(usize, usize)> =
            self.settled(times).filter_map(|k| Some((k, self.tick_of(k)?))).collect();
        let selected = |joint: &str| joints.is_none_or(|joints| joints.iter().any(|name| name == joint));
        let mut errors = Vec::new();
        for (j, (joint, unit)) in q.elements().iter().zip(q.units()).enumerate() {
            let Some(place) = reference.elements().iter().position(|name| name == joint) else { continue };
            if !selected(joint) {
                continue;
            }
            let distances = rows.iter().map(|&(k, tick)| (q.row(k)[j] - reference.row(tick)[place]).abs());
            errors.extend(ElementError::new(joint, unit, rms_and_max(distances)));
        }
        errors
    }

    /// Summarises the errors that a task has logged: those of its own coordinate, as the controller measured them.
    fn logged_errors(&self, name: &str) -> Vec<ElementError> {
        let Some(error) = self.tick.signal(&signal_names::of(name, ERROR)) else { return Vec::new() };
        let settled = self.settled(&self.tick.time_s);
        let elements = error.elements().iter().zip(error.units()).enumerate();
        let summarised = elements.filter_map(|(place, (element, unit))| {
            let distances = settled.clone().map(|k| error.row(k)[place].abs());
            ElementError::new(element, unit, rms_and_max(distances.filter(|distance| distance.is_finite())))
        });
        summarised.collect()
    }

    /// Compares the true contact force on a task's frame with the target of its force axes.
    fn contact(&self, task: &CartesianParameters, controlled: ControlledFrame, metrics: &mut TaskMetrics) {
        let on_force = task.axes.with_mode(AxisMode::Force);
        let Some((forces, rows)) = self.forces_on(&task.frame).filter(|_| on_force[..3].contains(&true))
        else {
            return;
        };
        let Ok(directions) = task.axes_frame.resolve(&self.experiment.robot().model, controlled) else {
            return;
        };
        let target: Vector3<f64> = task.target_force().fixed_rows::<3>(0).into_owned();
        let settled = self.settled(self.joints.0);
        let (mut errors, mut touching) = (Vec::new(), Vec::new());
        let (mut begin_s, mut peak, mut losses, mut touched) = (None, None, 0, false);
        for (k, _, axes) in self.poses_of(rows, controlled, directions) {
            let force = axes.tr_mul(&total(&forces, k));
            let size = masked_norm(&force, &on_force[..3]);
            let since_start_s = self.joints.0[k] - self.start_s;
            let touches = size > CONTACT_N;
            if touches && begin_s.is_none() {
                begin_s = Some(since_start_s);
            }
            if begin_s.is_some_and(|begin_s| since_start_s <= begin_s + PEAK_S) {
                peak = Some(f64::max(peak.unwrap_or(0.0), size));
            }
            losses += u64::from(touched && !touches);
            touched = touches;
            if settled.contains(&k) {
                errors.push(masked_norm(&(force - target), &on_force[..3]));
                touching.push(f64::from(u8::from(touches)));
            }
        }
        // A streamed task gets its target from outside.
        let known = !matches!(task.reference, CartesianReference::Streamed(_));
        metrics.contact.force_rms_n = rms_and_max(errors.into_iter()).0.filter(|_| known);
        metrics.contact.in_contact_fraction = mean(touching.into_iter());
        (metrics.contact.contact_begin_s, metrics.contact.contact_peak_n) = (begin_s, peak);
        metrics.contact.contact_losses = Some(losses);
    }

    /// Computes the motion of a task's frame along its compliant axes, and the work done on it there.
    fn compliance(&self, task: &CartesianParameters, controlled: ControlledFrame, metrics: &mut TaskMetrics) {
        let compliant = task.axes.with_mode(AxisMode::Compliant);
        let Ok(directions) = task.axes_frame.resolve(&self.experiment.robot().model, controlled) else {
            return;
        };
        if !compliant[..3].contains(&true) {
            return;
        }
        let Some((_, start, _)) = self.poses_of(self.controlled(), controlled, directions).next() else {
            return;
        };
        let poses: Vec<(usize, Placement, Matrix3<f64>)> =
            self.poses_of(self.settled(self.joints.0), controlled, directions).collect();
        let moved = poses.iter().map(|(_, pose, axes)| {
            masked_norm(&axes.tr_mul(&(pose.translation - start.translation)), &compliant[..3])
        });
        metrics.compliance.compliant_motion_rms_m = rms_and_max(moved).0;
        if let Some((forces, _)) = self.forces_on(&task.frame).filter(|(forces, _)| !forces.is_empty()) {
            let steps = poses.windows(2).map(|pair| {
                let [(k, from, axes), (_, to, _)] = pair else { return 0.0 };
                let force = axes.tr_mul(&total(&forces, *k));
                let step = axes.tr_mul(&(to.translation - from.translation));
                (0..3).filter(|&axis| compliant[axis]).map(|axis| force[axis] * step[axis]).sum()
            });
            metrics.compliance.compliant_work_j = Some(steps.sum());
        }
    }

    /// True forces of the objects of the environment that act on the body of a frame, and the rows of control; `None`
    /// if the log has no true state.
    pub(crate) fn forces_on(&self, frame: &str) -> Option<(Vec<Column<'_>>, Range<usize>)> {
        let model = &self.experiment.robot().model;
        let body = |name: &str| model.frame_id(name).ok().map(|id: FrameId| model.frame(id).body);
        let truth = self.recording.channel(TRUTH_CHANNEL)?;
        let objects = self.experiment.task().file.environment.iter();
        let on_body = objects.filter(|(_, object)| body(object.frame()) == body(frame));
        let forces: Vec<_> =
            on_body.filter_map(|(name, _)| truth.signal(&signal_names::of(name, FORCE))).collect();
        Some((forces, self.controlled()))
    }
}

impl ElementError {
    fn new(name: &str, unit: &str, (rms, max): (Option<f64>, Option<f64>)) -> Option<Self> {
        Some(Self { name: name.to_owned(), unit: unit.to_owned(), rms: rms?, max: max? })
    }
}

/// Sum of the forces in row `k`, world axes.
pub(crate) fn total(forces: &[Column<'_>], k: usize) -> Vector3<f64> {
    forces.iter().map(|force| Vector3::from_column_slice(force.row(k))).sum()
}

/// Converts a logged orientation: a quaternion, real part first.
pub(crate) fn orientation(wxyz: &[f64]) -> Matrix3<f64> {
    let quaternion = Quaternion::new(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
    UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().into_inner()
}
