//! Search for postures and goals of an arm.

use nalgebra::{DMatrix, DVector, Matrix6xX, Rotation3, UnitQuaternion, Vector3, Vector6};
use opspace_control::CollisionLimits;
use opspace_model::collision::{CollisionData, collision_distances, distance_gradient};
use opspace_model::{Data, Model, frame_jacobian, update};
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// Number of descents from random postures that look for a posture at the goal.
const DESCENTS: usize = 30;

/// Goal relative to the start pose, or in the world.
#[derive(Clone, Copy, Debug)]
pub struct Goal {
    pub position: Vector3<f64>,
    pub orientation: UnitQuaternion<f64>,
}

/// Distances that a search keeps.
pub struct Kept<'a> {
    limits: &'a CollisionLimits,
    data: CollisionData,
}

impl<'a> Kept<'a> {
    pub fn new(limits: &'a CollisionLimits) -> Self {
        Self { limits, data: CollisionData::new(&limits.geometry) }
    }

    /// Pairs closer than the margin in the state of `data`: by how much (m), and the gradient of the distance.
    fn violated(&mut self, model: &Model, data: &Data) -> Vec<(f64, DVector<f64>)> {
        let Self { limits, data: distances } = self;
        let margin_m = limits.margin_m;
        collision_distances(&limits.geometry, model, data, margin_m, distances);
        let pairs = distances.near().map(|(pair, proximity)| {
            let mut gradient = DVector::zeros(model.n());
            distance_gradient(&limits.geometry, model, data, pair, proximity, gradient.as_mut_slice());
            (margin_m - proximity.distance_m, gradient)
        });
        pairs.collect()
    }
}

/// Weight of the distances that a search keeps, relative to the error of the task.
const KEPT: f64 = 30.0;

/// Search for postures at a goal, within the position limits.
pub struct Search<'a> {
    pub collision: Option<Kept<'a>>,
    model: &'a Model,
    data: Data,
    frame: opspace_model::FrameId,
    rows: Vec<usize>,
    length_m: f64,
}

impl<'a> Search<'a> {
    pub fn new(model: &'a Model, frame: &str, axes: &[&str], length_m: f64) -> Self {
        let all = ["x", "y", "z", "rx", "ry", "rz"];
        Self {
            collision: None,
            model,
            data: Data::new(model),
            frame: model.frame_id(frame).expect("a frame"),
            rows: axes.iter().map(|axis| all.iter().position(|x| x == axis).expect("an axis")).collect(),
            length_m,
        }
    }

    /// Position limits with the margin that the controller keeps.
    fn range(&self, i: usize) -> (f64, f64) {
        let limits = &self.model.joints()[i].limits;
        (limits.lower.max(-6.2) + 0.01, limits.upper.min(6.2) - 0.01)
    }

    /// Random posture within the given fraction of the joint ranges, at most 2 rad from the centre.
    pub fn inner_posture(&self, random: &mut impl Rng, fraction: f64) -> Vec<f64> {
        (0..self.model.n())
            .map(|i| {
                let (lower, upper) = self.range(i);
                let half = (0.5 * fraction * (upper - lower)).min(2.0);
                0.5 * (lower + upper) + half * random.random_range(-1.0..1.0)
            })
            .collect()
    }

    pub fn pose(&mut self, q: &[f64]) -> Goal {
        assert!(update(self.model, &mut self.data, q, &vec![0.0; q.len()]));
        let placement = opspace_model::frame_placement(self.model, &self.data, self.frame);
        let rotation = Rotation3::from_matrix_unchecked(placement.rotation);
        Goal { position: placement.translation, orientation: UnitQuaternion::from_rotation_matrix(&rotation) }
    }

    /// The goal in the world.
    pub fn target(&mut self, start: &[f64], goal: Goal) -> Goal {
        let pose = self.pose(start);
        Goal { position: pose.position + goal.position, orientation: goal.orientation * pose.orientation }
    }

    /// Error of the controlled rows, rotations scaled by the length.
    pub fn error(&mut self, q: &[f64], target: &Goal) -> Vector6<f64> {
        let pose = self.pose(q);
        let turn = (target.orientation * pose.orientation.inverse()).scaled_axis() * self.length_m;
        let far = target.position - pose.position;
        let mut error = Vector6::zeros();
        for (k, &row) in self.rows.iter().enumerate() {
            error[k] = if row < 3 { far[row] } else { turn[row - 3] };
        }
        error
    }

    /// Error and kept distances at a posture: the error of the rows, then by how much each pair is too close, weighted;
    /// with the derivatives (one row each).
    fn residuals(&mut self, q: &[f64], target: &Goal) -> (DVector<f64>, DMatrix<f64>) {
        let (n, error) = (q.len(), self.error(q, target));
        let mut jacobian = Matrix6xX::zeros(n);
        frame_jacobian(self.model, &self.data, self.frame, &mut jacobian);
        let violated =
            self.collision.as_mut().map(|kept| kept.violated(self.model, &self.data)).unwrap_or_default();
        let count = self.rows.len();
        let mut values = DVector::zeros(count + violated.len());
        let mut rows = DMatrix::zeros(values.len(), n);
        for (r, &row) in self.rows.iter().enumerate() {
            values[r] = error[r];
            rows.row_mut(r).copy_from(&(jacobian.row(row) * if row < 3 { 1.0 } else { self.length_m }));
        }
        for (k, (depth, gradient)) in violated.iter().enumerate() {
            values[count + k] = KEPT * depth;
            rows.row_mut(count + k).copy_from(&(gradient.transpose() * KEPT));
        }
        (values, rows)
    }

    /// Levenberg-Marquardt steps with clamped joints; returns the posture and the norm of its error.
    pub fn descend(&mut self, mut q: Vec<f64>, target: &Goal) -> (Vec<f64>, f64) {
        let n = q.len();
        let (mut values, mut rows) = self.residuals(&q, target);
        let mut best = values.norm();
        let mut damping = 1e-3;
        for _ in 0..300 {
            let gradient = rows.transpose() * &values;
            let held: Vec<bool> = (0..n)
                .map(|i| {
                    let (lower, upper) = self.range(i);
                    (q[i] >= upper && gradient[i] > 0.0) || (q[i] <= lower && gradient[i] < 0.0)
                })
                .collect();
            let free = DMatrix::from_fn(rows.nrows(), n, |r, c| if held[c] { 0.0 } else { rows[(r, c)] });
            let right: DVector<f64> = free.transpose() * &values;
            let normal = free.transpose() * &free + DMatrix::identity(n, n) * damping;
            let step = normal.cholesky().expect("positive definite").solve(&right);
            let next: Vec<f64> = (0..n)
                .map(|i| {
                    let (lower, upper) = self.range(i);
                    (q[i] + step[i].clamp(-0.3, 0.3)).clamp(lower, upper)
                })
                .collect();
            let there = self.residuals(&next, target);
            let reached = there.0.norm();
            if reached < best {
                let small = best - reached < 1e-12;
                (q, best, damping) = (next, reached, (damping * 0.3).max(1e-9));
                (values, rows) = there;
                if small {
                    break;
                }
            } else {
                damping *= 5.0;
                if damping > 1e6 {
                    break;
                }
            }
        }
        let error = self.error(&q, target).norm();
        (q, error)
    }

    /// Goal, relative to the start pose, that this posture reaches.
    pub fn offset(&mut self, start: &[f64], posture: &[f64]) -> Goal {
        let (from, to) = (self.pose(start), self.pose(posture));
        Goal {
            position: to.position - from.position,
            orientation: to.orientation * from.orientation.inverse(),
        }
    }

    /// Offset of a goal that is reached by a posture near the start.
    pub fn goal_at(&mut self, start: &[f64], random: &mut impl Rng) -> Goal {
        let near: Vec<f64> = (0..start.len())
            .map(|i| {
                let (lower, upper) = self.range(i);
                (start[i] + random.random_range(-0.4..0.4)).clamp(lower + 0.2, upper - 0.2)
            })
            .collect();
        self.offset(start, &near)
    }

    /// Offset of a goal that no descent from random postures reaches.
    pub fn unreachable(&mut self, start: &[f64], random: &mut ChaCha8Rng) -> Goal {
        loop {
            let posture = self.inner_posture(random, 1.0);
            let pose = self.pose(&posture);
            let direction = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
            let from = self.pose(start);
            let mut goal = Goal {
                position: pose.position + direction * random.random_range(0.0..self.length_m) - from.position,
                orientation: pose.orientation * from.orientation.inverse(),
            };
            if !self.rows.contains(&1) {
                goal.position.y = 0.0;
            }
            let target = self.target(start, goal);
            let reached = (0..DESCENTS).any(|descent| {
                let q = if descent == 0 { start.to_vec() } else { self.inner_posture(random, 1.0) };
                self.descend(q, &target).1 < 0.01
            });
            if !reached {
                return goal;
            }
        }
    }
}
