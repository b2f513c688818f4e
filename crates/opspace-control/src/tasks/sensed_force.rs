//! Filtered reading of a force sensor, at the origin of a task's frame.
//!
//! ```text
//! [Aᵀ f; Aᵀ (m + l × f)]        l = x_sensor − x_frame
//! ```
//!
//! f and m are force and moment of the filtered reading in world axes, A the axes of the task.

use crate::measurement::Measurement;
use nalgebra::{Matrix3, Vector3, Vector6};
use opspace_backend::LowPass;
use opspace_model::{Data, FrameId, Model, frame_placement};

/// A force sensor of the robot with a filter.
#[derive(Clone, Debug)]
pub struct SensedForce {
    sensor: usize,
    /// Frame of the sensor.
    pub frame: FrameId,
    filter: LowPass<6>,
}

impl SensedForce {
    /// Returns the sensor with this index in [`ControlContext::sensors`](crate::ControlContext::sensors) and its frame, filtered with the corner frequency `filter_hz` (Hz).
    #[must_use]
    pub fn new(sensor: usize, frame: FrameId, filter_hz: f64, period_s: f64) -> Self {
        Self { sensor, frame, filter: LowPass::new(filter_hz, period_s) }
    }

    /// Starts the filter at the present reading, and returns it (N, Nm; world axes).
    ///
    /// # Panics
    /// If the measurement has no such sensor.
    pub fn start(&mut self, measurement: &Measurement) -> [f64; 6] {
        let raw = self.raw(measurement);
        self.filter.reset(&raw);
        raw
    }

    /// Continues with the state of another filter if it is of the same sensor.
    pub(crate) fn inherit_state(&mut self, before: &Self) {
        if self.sensor == before.sensor {
            self.filter.reset(before.filter.output());
        }
    }

    /// Filters the present reading, and returns the result (N, Nm; world axes).
    ///
    /// # Panics
    /// If the measurement has no such sensor.
    pub fn update(&mut self, measurement: &Measurement) -> [f64; 6] {
        let raw = self.raw(measurement);
        self.filter.update(&raw)
    }

    /// Converts a reading (N, Nm; world axes) to force and moment at `point` (m), in the axes `rotation` (one per column).
    #[must_use]
    pub fn at(
        &self,
        (model, data): (&Model, &Data),
        reading: &[f64; 6],
        point: &Vector3<f64>,
        rotation: &Matrix3<f64>,
    ) -> Vector6<f64> {
        let [fx, fy, fz, mx, my, mz] = *reading;
        let force = Vector3::new(fx, fy, fz);
        let lever = frame_placement(model, data, self.frame).translation - point;
        let (linear, angular) =
            (rotation.tr_mul(&force), rotation.tr_mul(&(Vector3::new(mx, my, mz) + lever.cross(&force))));
        Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
    }

    fn raw(&self, measurement: &Measurement) -> [f64; 6] {
        let f = &measurement.wrenches[self.sensor];
        [f.linear.x, f.linear.y, f.linear.z, f.angular.x, f.angular.y, f.angular.z]
    }
}
