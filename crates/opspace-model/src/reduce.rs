//! Reduced models: joints locked at a position or coupled to other joints.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{MimicConstraint, Model};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let stiff = model.with_locked_joints(&[(2, 1.2), (5, 0.0)]).expect("joints that it has");
//! assert_eq!(stiff.n(), 4);
//! let mimic = MimicConstraint { leader: 1, ratio: -1.0, offset: 0.5 };
//! assert_eq!(model.with_mimic_constraints(&[(2, mimic)]).expect("joints that it has").n(), 5);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::model::{Body, Frame, Joint, JointKind, Model};
use crate::spatial::Placement;
use thiserror::Error;

/// Coupling of a mimic joint to its leader: the position of the joint is `ratio` q + `offset` (rad, m), with q the
/// position of the leader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MimicConstraint {
    /// Index of the leader.
    pub leader: usize,
    /// Ratio of the velocity of the joint to that of the leader.
    pub ratio: f64,
    /// Position of the joint for leader position zero, rad or m.
    pub offset: f64,
}

/// Reason why a joint cannot be locked or coupled.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum ReduceError {
    /// Joint index out of range.
    #[error("no joint {joint}: the model has {count} joints, numbered from 0")]
    NoSuchJoint {
        /// Requested index.
        joint: usize,
        /// Number of joints of the model.
        count: usize,
    },
    /// Joint given twice.
    #[error("joint '{joint}' is given twice; remove one")]
    Repeated {
        /// Name of the joint.
        joint: String,
    },
    /// Coordinate of a floating base, which cannot be locked or take part in a mimic constraint.
    #[error("'{joint}' is part of the floating base; load the URDF with a fixed base instead")]
    Base {
        /// Name of the coordinate.
        joint: String,
    },
    /// Position, ratio or offset that is not finite.
    #[error("joint '{joint}': {value} is not finite")]
    NotFinite {
        /// Name of the joint.
        joint: String,
        /// Value as given.
        value: f64,
    },
    /// Mimic joints that form a cycle.
    #[error("joint '{joint}' mimics itself")]
    FollowsItself {
        /// Name of one joint of the cycle.
        joint: String,
    },
}

impl Model {
    /// Returns the robot with some joints locked, each at a position (rad, m). The body of a locked joint is fixed to
    /// its parent body. The other joints keep their order and all frames keep their names. The rotor inertias of locked
    /// joints are dropped. In Pinocchio `buildReducedModel`.
    ///
    /// # Errors
    /// [`ReduceError`], which names the invalid joint.
    pub fn with_locked_joints(&self, positions: &[(usize, f64)]) -> Result<Self, ReduceError> {
        let mut locked_at = vec![None; self.n()];
        for &(joint, position) in positions {
            self.reducible(joint, &[position])?;
            if locked_at[joint].replace(position).is_some() {
                return Err(ReduceError::Repeated { joint: self.joints[joint].name.clone() });
            }
        }
        let mut left = Self { base: self.base, gravity: self.gravity, ..Self::new(&self.name) };
        left.floating = self.floating;
        // `numbers`: new index of each remaining joint. `places`: for each old body, the remaining body that contains
        // it and its pose there.
        let mut numbers = vec![0; self.n()];
        for joint in (0..self.n()).filter(|&joint| locked_at[joint].is_none()) {
            numbers[joint] = left.joints.len();
            left.joints.push(self.joints[joint].clone());
            left.rotor_inertia.push(self.rotor_inertia[joint]);
        }
        let mut places: Vec<(Option<usize>, Placement)> = Vec::with_capacity(self.bodies.len());
        for (body, own) in self.bodies.iter().zip(&self.own) {
            let (parent, parent_placement) = body.parent.map_or((None, Placement::identity()), |p| places[p]);
            let at_zero = parent_placement * body.origin;
            if let Some(q) = locked_at[body.joint] {
                let x = body.ratio * q + body.offset;
                let place = body.kind.placement(&at_zero, x, x.sin_cos());
                if let Some(p) = parent {
                    left.own[p] = left.own[p] + place.act_inertia(own);
                }
                places.push((parent, place));
                continue;
            }
            places.push((Some(left.bodies.len()), Placement::identity()));
            left.own.push(*own);
            left.bodies.push(Body { parent, origin: at_zero, joint: numbers[body.joint], ..*body });
        }
        for (frame, payload) in self.frames.iter().zip(&self.payloads) {
            let (body, body_placement) = frame.body.map_or((None, Placement::identity()), |b| places[b]);
            let placement = body_placement * frame.placement;
            left.frames.push(Frame { name: frame.name.clone(), body, placement });
            left.payloads.push(*payload);
        }
        (0..left.bodies.len()).for_each(|body| left.update_body_inertia(Some(body)));
        Ok(left)
    }

    /// Returns the robot with some joints coupled to others (mimic joints): each of `followers` is a joint with its
    /// leader, and the ratio and offset (rad, m) of `q_follower = ratio q_leader + offset`. The bodies of a follower
    /// move with the coordinate of the leader; the follower's own coordinate and limits are removed. Its rotor inertia,
    /// times ratio², is added to that of the leader.
    ///
    /// # Errors
    /// [`ReduceError`], which names the invalid joint.
    pub fn with_mimic_constraints(
        &self,
        followers: &[(usize, MimicConstraint)],
    ) -> Result<Self, ReduceError> {
        let mut follows: Vec<Option<MimicConstraint>> = vec![None; self.n()];
        for &(joint, rule) in followers {
            self.reducible(joint, &[rule.ratio, rule.offset])?;
            self.reducible(rule.leader, &[])?;
            if follows[joint].replace(rule).is_some() {
                return Err(ReduceError::Repeated { joint: self.joints[joint].name.clone() });
            }
        }
        let mut folded = self.clone();
        folded.joints.clear();
        folded.rotor_inertia.clear();
        let mut numbers = vec![0; self.n()];
        for joint in (0..self.n()).filter(|&joint| follows[joint].is_none()) {
            numbers[joint] = folded.joints.len();
            folded.joints.push(self.joints[joint].clone());
            folded.rotor_inertia.push(self.rotor_inertia[joint]);
        }
        // Every joint as a function of a remaining joint.
        let mut rules = Vec::with_capacity(self.n());
        for joint in 0..self.n() {
            let mut rule = MimicConstraint { leader: joint, ratio: 1.0, offset: 0.0 };
            let mut steps = 0;
            while let Some(next) = follows[rule.leader] {
                rule.offset += rule.ratio * next.offset;
                rule.ratio *= next.ratio;
                rule.leader = next.leader;
                steps += 1;
                if steps > self.n() {
                    // After n steps the leader is certainly on the cycle, even if the chain starts outside it.
                    return Err(ReduceError::FollowsItself { joint: self.joints[rule.leader].name.clone() });
                }
            }
            if let Some(&value) = [rule.ratio, rule.offset].iter().find(|x| !x.is_finite()) {
                return Err(ReduceError::NotFinite { joint: self.joints[joint].name.clone(), value });
            }
            if follows[joint].is_some() {
                folded.rotor_inertia[numbers[rule.leader]] +=
                    rule.ratio * rule.ratio * self.rotor_inertia[joint];
            }
            rules.push(rule);
        }
        for body in &mut folded.bodies {
            let rule = rules[body.joint];
            body.offset += body.ratio * rule.offset;
            body.ratio *= rule.ratio;
            body.follows |= follows[body.joint].is_some();
            body.joint = numbers[rule.leader];
        }
        Ok(folded)
    }

    fn reducible(&self, joint: usize, values: &[f64]) -> Result<(), ReduceError> {
        let Some(Joint { name, kind, .. }) = self.joints.get(joint) else {
            return Err(ReduceError::NoSuchJoint { joint, count: self.n() });
        };
        let joint = || name.clone();
        if *kind == JointKind::Floating {
            return Err(ReduceError::Base { joint: joint() });
        }
        match values.iter().find(|x| !x.is_finite()) {
            Some(&value) => Err(ReduceError::NotFinite { joint: joint(), value }),
            None => Ok(()),
        }
    }
}
