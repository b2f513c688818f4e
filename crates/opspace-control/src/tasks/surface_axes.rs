//! Task axes that turn with the normal of the surface that the hand touches.
//!
//! In contact the hand moves along the surface, and friction acts along the motion. Hence the part of the sensed force f
//! across the velocity v has the direction of the normal, whatever the friction is (Yoshikawa and Sudou 1993):
//!
//! ```text
//! n = (f − v (f·v)/|v|²) / |f − v (f·v)/|v|²|
//! ```
//!
//! Over a path of the length l, the axis of the force turns toward n by the fraction 1 − 1/e of the angle between them; the
//! other axes turn with it, without turning about it. On a surface of the radius R the axis lags by the angle l/R. At rest
//! and without contact, the axes keep their directions.

use crate::axis_mode::AxisMode;
use crate::error::Reason;
use crate::tasks::axes::{AxesFrame, AxesFrameParameter};
use crate::tasks::cartesian_parameters::CartesianParameters;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Slowest motion that tells the normal, m/s.
const LEAST_SPEED_M_PER_S: f64 = 0.005;

/// Smallest part of the force across the motion that tells the normal, N.
const LEAST_FORCE_N: f64 = 2.0;

/// Largest share of the speed along the axis of the force: above, the hand hits or leaves the surface.
const LARGEST_NORMAL_SHARE: f64 = 0.7;

/// Present directions of task axes on a surface.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceAxes {
    /// Axis of the force: 0, 1 or 2.
    axis: usize,
    length_m: f64,
    period_s: f64,
    /// Axes in the coordinates of the controlled frame.
    directions: UnitQuaternion<f64>,
}

/// Returns the axes of a task that turns with a surface, which begin as those of `initial`; `None` for other tasks.
///
/// # Errors
/// [`Reason::SurfaceNormal`] if it is not exactly one of the axes x, y and z that is in force control.
pub(crate) fn surface_axes(
    task: &CartesianParameters,
    initial: &AxesFrame,
    period_s: f64,
) -> Result<Option<SurfaceAxes>, Reason> {
    let AxesFrameParameter::Surface(parameters) = &task.axes_frame else { return Ok(None) };
    let axis = match task.axes.with_mode(AxisMode::Force) {
        [true, false, false, ..] => 0,
        [false, true, false, ..] => 1,
        [false, false, true, ..] => 2,
        _ => return Err(Reason::SurfaceNormal),
    };
    Ok(Some(SurfaceAxes::new(axis, parameters.length_m.get(), &initial.at_rest(), period_s)))
}

impl SurfaceAxes {
    /// Creates the axes with their directions at the start, one per column. `axis` is the axis of the force.
    fn new(axis: usize, length_m: f64, initial: &Matrix3<f64>, period_s: f64) -> Self {
        let directions = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*initial));
        Self { axis, length_m, period_s, directions }
    }

    /// Axis of the force: 0, 1 or 2.
    pub(crate) fn axis(&self) -> usize {
        self.axis
    }

    /// Axes in the coordinates of the controlled frame, one per column.
    pub(crate) fn rotation(&self) -> Matrix3<f64> {
        self.directions.to_rotation_matrix().into_inner()
    }

    /// Takes over the directions of another task set.
    pub(crate) fn inherit_state(&mut self, before: &Self) {
        self.directions = before.directions;
    }

    /// Turns the axes for a control period with the sensed force (N) and the velocity (m/s), both in the coordinates of
    /// the controlled frame.
    pub(crate) fn update(&mut self, force: &Vector3<f64>, velocity: &Vector3<f64>) {
        let speed = velocity.norm();
        let present = self.directions * Vector3::ith(self.axis, 1.0);
        if speed < LEAST_SPEED_M_PER_S || velocity.dot(&present).abs() > LARGEST_NORMAL_SHARE * speed {
            return;
        }
        let direction = velocity / speed;
        let across = force - direction * direction.dot(force);
        let size = across.norm();
        if size < LEAST_FORCE_N {
            return;
        }
        // The axis may point into the surface.
        let normal = across / size * across.dot(&present).signum();
        let share = 1.0 - (-speed * self.period_s / self.length_m).exp();
        let turn = present.cross(&normal);
        let (sine, cosine) = (turn.norm(), present.dot(&normal));
        if sine > 0.0 {
            let step = UnitQuaternion::from_scaled_axis(turn / sine * (share * sine.atan2(cosine)));
            self.directions = step * self.directions;
            self.directions.renormalize_fast();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rounding of a few thousand steps, and the lag of the filter at the end.
    const ROUNDING: f64 = 1e-9;

    fn slide(
        axes: &mut SurfaceAxes,
        normal: Vector3<f64>,
        direction: Vector3<f64>,
        friction: f64,
        path_m: f64,
    ) {
        let velocity = (direction - normal * normal.dot(&direction)).normalize() * 0.1;
        let force = normal * 20.0 - velocity.normalize() * (friction * 20.0);
        for _ in 0..(path_m / (0.1 * 1e-3)) as usize {
            axes.update(&force, &velocity);
        }
    }

    #[test]
    fn axis_finds_the_normal_whatever_the_friction() {
        for friction in [0.0, 0.25, 1.0] {
            for direction in [Vector3::x(), Vector3::y(), Vector3::new(1.0, -2.0, 0.3)] {
                let normal = Vector3::new(0.3, -0.2, 1.0).normalize();
                let mut axes = SurfaceAxes::new(2, 0.003, &Matrix3::identity(), 1e-3);
                slide(&mut axes, normal, direction, friction, 0.1);
                let found = axes.rotation().column(2).into_owned();
                assert!((found - normal).norm() < ROUNDING, "{found}");
            }
        }
    }

    #[test]
    fn axis_that_points_into_the_surface_keeps_pointing_into_it() {
        let normal = Vector3::new(0.3, -0.2, -1.0).normalize();
        let mut axes = SurfaceAxes::new(2, 0.003, &Matrix3::identity(), 1e-3);
        slide(&mut axes, normal, Vector3::x(), 0.25, 0.1);
        assert!((axes.rotation().column(2) + normal).norm() < ROUNDING);
    }

    #[test]
    fn the_angle_falls_by_the_stated_fraction_over_the_length() {
        let normal = Vector3::new(0.0, 0.2_f64.sin(), 0.2_f64.cos());
        let mut axes = SurfaceAxes::new(2, 0.003, &Matrix3::identity(), 1e-3);
        slide(&mut axes, normal, Vector3::x(), 0.25, 0.003);
        let angle = axes.rotation().column(2).dot(&normal).acos();
        assert!((angle - 0.2 * (-1.0_f64).exp()).abs() < ROUNDING, "{angle}");
    }

    #[test]
    fn axes_stay_at_rest_and_without_contact() {
        let mut axes = SurfaceAxes::new(2, 0.003, &Matrix3::identity(), 1e-3);
        axes.update(&Vector3::new(5.0, 0.0, 20.0), &Vector3::zeros());
        axes.update(&Vector3::new(5.0, 0.0, 20.0), &Vector3::new(0.001, 0.0, 0.0));
        axes.update(&Vector3::new(0.5, 0.0, 1.0), &Vector3::new(0.1, 0.0, 0.0));
        axes.update(&Vector3::new(5.0, 0.0, 20.0), &Vector3::new(0.0, 0.0, -0.1));
        assert_eq!(axes.rotation(), Matrix3::identity());
    }

    #[test]
    fn the_axes_turn_without_turning_about_the_normal() {
        // Once over a cylinder whose axis is x, and back: y stays in the plane of the motion, and x is parallel to the cylinder.
        let mut axes = SurfaceAxes::new(2, 0.003, &Matrix3::identity(), 1e-3);
        for step in (0..1500).chain((0..1500).rev()) {
            let angle = f64::from(step) * 1e-3;
            let normal = Vector3::new(0.0, angle.sin(), angle.cos());
            slide(&mut axes, normal, normal.cross(&Vector3::x()), 0.25, 1e-3);
            assert!((axes.rotation().column(0) - Vector3::x()).norm() < ROUNDING);
        }
    }
}
