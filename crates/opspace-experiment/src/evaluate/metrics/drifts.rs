//! Drifts of compliant axes: a frame that moves away along them, and what moved it.

use super::task_axes::{TaskAxes, TaskRow};
use crate::codes::Code;
use crate::files::controller_kind::ControllerKind;
use crate::finding::{Finding, Place};
use crate::run::experiment::Experiment;
use nalgebra::Vector3;
use opspace_control::AXIS_NAMES;
use opspace_control::orientation::log;
use opspace_log::Column;
use opspace_model::Placement;
use opspace_sim::EnvironmentObjectParameters;
use std::collections::BTreeSet;

/// Smallest displacement that counts as a drift, m and rad.
const DRIFTED_M: f64 = 20e-3;
const DRIFTED_RAD: f64 = 0.1;

/// Smallest part of the largest displacement that is named.
const NAMED: f64 = 0.1;

/// Smallest true force of an object that acts on the frame, N.
const ACTS_N: f64 = 0.1;

/// Drifts of a task, while rows of its log arrive.
#[derive(Default)]
pub(super) struct Drifts {
    present: Option<Drift>,
    largest: Option<Drift>,
}

/// Motion along compliant axes, from the time at which the first of them became compliant.
#[derive(Default)]
struct Drift {
    /// Pose at which each axis became compliant; `None` while it is not.
    starts: [Option<Placement>; 6],
    /// Time since which the frame is away, s after the start of control.
    begin_s: Option<f64>,
    /// Displacements at the last row, m and rad.
    last: [f64; 6],
    /// Displacements where they were largest.
    most: [f64; 6],
    /// True if the log has the true forces.
    knows_forces: bool,
    /// Objects of the environment that acted on the frame before it was away.
    acted: BTreeSet<String>,
}

impl Drifts {
    /// Adds a row, the axes of the task there, and the true forces on its frame; `None` if the log has none.
    pub(super) fn add(
        &mut self,
        row: &TaskRow,
        axes: &TaskAxes,
        since_start_s: f64,
        forces: Option<&[(&str, Column<'_>)]>,
    ) {
        let [x, y, z] = axes.compliant;
        let [rx, ry, rz] = axes.compliant_rotations;
        let compliant = [x, y, z, rx, ry, rz];
        if !compliant.contains(&true) {
            self.leave();
            return;
        }
        let drift = self.present.get_or_insert_default();
        for (start, is_compliant) in drift.starts.iter_mut().zip(compliant) {
            *start = is_compliant.then(|| start.unwrap_or(row.pose));
        }
        drift.last = displacements(row, &drift.starts);
        if size(&drift.last) > size(&drift.most) {
            drift.most = drift.last;
        }
        if drift.begin_s.is_none() {
            drift.knows_forces = forces.is_some();
            for (name, force) in forces.into_iter().flatten() {
                if Vector3::from_column_slice(force.row(row.k)).norm() > ACTS_N {
                    drift.acted.insert((*name).to_owned());
                }
            }
            drift.begin_s = (size(&drift.last) > 1.0).then_some(since_start_s);
        }
    }

    /// Notes that the task has no compliant axis.
    pub(super) fn leave(&mut self) {
        let Some(drift) = self.present.take() else { return };
        if self.largest.as_ref().is_none_or(|largest| size(&drift.most) > size(&largest.most)) {
            self.largest = Some(drift);
        }
    }

    /// Returns the largest drift, unless what moved the frame was to move it: a hand that holds it, or a contact.
    pub(super) fn finish(mut self, experiment: &Experiment, task: &str) -> Option<Finding> {
        self.leave();
        let drift = self.largest?;
        let begin_s = drift.begin_s?;
        // Inverse kinematics has no compliant axes, and objects that robots hold together are not in the log of one.
        if experiment.options().controller != ControllerKind::Osc || experiment.membership().is_some() {
            return None;
        }
        let environment = &experiment.task().file.environment;
        let acted = || environment.iter().filter(|(name, _)| drift.acted.contains(name.as_str()));
        let mut load = None;
        let mut pushes = None;
        for (name, object) in acted() {
            match object {
                EnvironmentObjectParameters::Mass(mass) => load = Some((name, mass.mass_kg.get())),
                EnvironmentObjectParameters::Pushes(_) => pushes = Some(name),
                _ => return None,
            }
        }
        let is_pushed = load.is_none() && pushes.is_some();
        // Pushes move a compliant axis: only where they leave it counts.
        let moved = if is_pushed { &drift.last } else { &drift.most };
        if size(moved) <= 1.0 {
            return None;
        }
        let cause = match (load, pushes) {
            (Some((name, kg)), _) => format!("nothing holds the load '{name}' of {kg} kg along them"),
            (None, Some(name)) => format!("'{name}' pushed it, and nothing brings it back"),
            (None, None) if drift.knows_forces => "no object of the environment touched it".to_owned(),
            (None, None) => "the log does not have what moved it".to_owned(),
        };
        let message = format!(
            "task '{task}': its compliant axes moved by {}, from {begin_s:.2} s on: {cause}",
            text(moved)
        );
        let finding = Finding::of(Code::CompliantAxesMoved, Place::Task(task.to_owned()), message)
            .with("begin_s", Some(begin_s))
            .with("load_kg", load.map(|(_, kg)| kg));
        Some(named(moved).fold(finding, |finding, axis| {
            let unit = if axis < 3 { "m" } else { "rad" };
            finding.with(&format!("{}_{unit}", AXIS_NAMES[axis]), Some(moved[axis]))
        }))
    }
}

/// Displacements of a pose from the start of each axis, along the axes of the task; zero along others.
fn displacements(row: &TaskRow, starts: &[Option<Placement>; 6]) -> [f64; 6] {
    let mut moved = [0.0; 6];
    for (axis, start) in starts.iter().enumerate() {
        let Some(start) = start else { continue };
        let by = if axis < 3 {
            row.pose.translation - start.translation
        } else {
            log(&(row.pose.rotation * start.rotation.transpose()))
        };
        moved[axis] = row.rotation.column(axis % 3).dot(&by);
    }
    moved
}

/// Displacement along each axis relative to the smallest that counts.
fn relative(moved: &[f64; 6], axis: usize) -> f64 {
    moved[axis].abs() / if axis < 3 { DRIFTED_M } else { DRIFTED_RAD }
}

/// Largest displacement relative to the smallest that counts.
fn size(moved: &[f64; 6]) -> f64 {
    (0..6).map(|axis| relative(moved, axis)).fold(0.0, f64::max)
}

/// Axes along which the displacements are considerable.
fn named(moved: &[f64; 6]) -> impl Iterator<Item = usize> + '_ {
    (0..6).filter(|&axis| relative(moved, axis) > NAMED * size(moved))
}

/// Lists displacements: `-925 mm along z and 210 mrad along rx`.
fn text(moved: &[f64; 6]) -> String {
    let of_axis = |axis: usize| {
        let unit = if axis < 3 { "mm" } else { "mrad" };
        format!("{:.0} {unit} along {}", 1e3 * moved[axis], AXIS_NAMES[axis])
    };
    named(moved).map(of_axis).collect::<Vec<_>>().join(" and ")
}
