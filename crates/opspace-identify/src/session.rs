//! Motion of one joint about its initial position while the other joints are held, with limits checked in every control
//! cycle.

use opspace_backend::{Backend, Command, DeviceFault, Sample};
use opspace_control::ramp::minimum_jerk;
use opspace_model::JointKind;
use thiserror::Error;

/// Time over which speed is computed as a finite difference, s.
const SPEED_OVER_S: f64 = 4e-3;

/// Time constant with which setpoints of held joints follow a changed weight, s, and distance of a joint from its posture up to
/// which they do not: within it, friction would make the joint hunt.
const FOLLOWS_WEIGHT_S: f64 = 1.0;
const HELD_WITHIN: f64 = 0.03;

/// Distance of a joint from a posture at which it has not been reached, or is not held, rad (m).
const NOT_REACHED: f64 = 0.12;

/// Ratio of the peak to the mean speed of a minimum-jerk motion.
pub(crate) const PEAK_OVER_MEAN: f64 = 1.875;

/// Limits of a joint during its excitation.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Largest distance from its initial position, rad (m).
    pub travel: f64,
    /// Largest speed, rad/s (m/s).
    pub speed: f64,
    /// Largest motor torque, including gravity, Nm (N).
    pub torque: f64,
}

/// Reason why a motion was aborted.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum AbortReason {
    /// Fault that the robot reported.
    #[error(transparent)]
    Fault(#[from] DeviceFault),
    /// Measured position that is not a finite number.
    #[error("the measured position of joint {0} is not a finite number")]
    NotFinite(usize),
    /// Distance from the initial position above the limit.
    #[error("it moved {0} rad (m) from its initial position")]
    Travel(f64),
    /// Speed above the limit.
    #[error("its speed reached {0} rad/s (m/s)")]
    Speed(f64),
    /// Motor torque above the limit.
    #[error("its motor torque reached {0} Nm (N)")]
    Torque(f64),
    /// Measured position outside the position limits.
    #[error("joint {joint} reached {position:.3} rad (m), outside its position limits")]
    Limit {
        /// Index of the joint.
        joint: usize,
        /// Measured position, rad (m).
        position: f64,
    },
    /// Posture that a joint does not reach, or does not hold.
    #[error(
        "joint {joint} stays {distance:.3} rad (m) away from its setpoint; is it in contact, or overloaded?"
    )]
    NotReached {
        /// Index of the joint.
        joint: usize,
        /// Distance, rad (m).
        distance: f64,
    },
    /// Requested interruption.
    #[error("interrupted")]
    Interrupted,
}

impl AbortReason {
    /// True if the robot can no longer be used; otherwise a smaller motion may be possible.
    #[must_use]
    pub fn is_final(&self) -> bool {
        matches!(self, Self::Fault(_) | Self::NotFinite(_) | Self::Interrupted)
    }
}

/// Setpoints and response of a joint at each control cycle, relative to its initial position.
#[derive(Clone, Debug, Default)]
pub struct Record {
    /// Offsets of the setpoints, rad (m).
    pub asked: Vec<f64>,
    /// Positions at the control cycles of the setpoints, rad (m).
    pub position: Vec<f64>,
    /// Mean motor torque over the interval after each control cycle, Nm (N); empty if not measured.
    pub torque: Vec<f64>,
}

impl Record {
    /// Largest absolute value.
    #[must_use]
    pub fn peak(values: &[f64]) -> f64 {
        values.iter().fold(0.0, |most, v| v.abs().max(most))
    }
}

/// Session with a robot that holds itself while one of its joints is moved.
pub struct ExcitationSession<'a> {
    robot: &'a mut dyn Backend,
    sample: Sample,
    /// Kinds of the joints (n).
    kinds: Vec<JointKind>,
    /// Position at which each joint is held (n; rad, m).
    posture: Vec<f64>,
    /// Offset of the setpoints from `posture` with which the servos hold the weight there (n; rad, m).
    bias: Vec<f64>,
    setpoints: Vec<f64>,
    ticks: u64,
    ended: &'a dyn Fn(u64) -> bool,
}

impl<'a> ExcitationSession<'a> {
    /// Takes control of the robot, whose joints are of these kinds (n), in its present position. Encoders of continuous joints may count
    /// within one turn. With setpoints at the measured positions it sags by the
    /// error that the servos need to hold its weight; this error is then added to all setpoints. `ended` is called with
    /// the number of control cycles and returns true to stop.
    ///
    /// # Errors
    /// If the robot fails, or the run is interrupted.
    pub fn begin(
        robot: &'a mut dyn Backend,
        kinds: &[JointKind],
        ended: &'a dyn Fn(u64) -> bool,
    ) -> Result<Self, AbortReason> {
        let sample = Sample::new(robot.capabilities());
        let joints = kinds.len();
        let zero = vec![0.0; joints];
        let mut session = Self {
            robot,
            sample,
            kinds: kinds.to_vec(),
            posture: zero.clone(),
            bias: zero.clone(),
            setpoints: zero,
            ticks: 0,
            ended,
        };
        session.robot.read(&mut session.sample)?;
        session.posture.copy_from_slice(session.sample.q.as_slice());
        session.setpoints.copy_from_slice(session.sample.q.as_slice());
        session.robot.write(Command::Position(&session.setpoints))?;
        session.find_bias()?;
        Ok(session)
    }

    /// Adds to the setpoints the error that the servos need to hold the weight in the present posture.
    fn find_bias(&mut self) -> Result<(), AbortReason> {
        for _ in 0..2 {
            self.rest(0.4)?;
            for i in 0..self.posture.len() {
                self.bias[i] += self.posture[i] - self.sample.q[i];
            }
        }
        self.rest(0.4)
    }

    /// Moves all joints to `posture` (n; rad, m) on a straight line, at most at `speed` (rad/s, m/s), and holds them there.
    ///
    /// # Errors
    /// If the robot fails, a joint does not reach its position, or the run is interrupted.
    pub fn move_to(&mut self, posture: &[f64], speed: f64) -> Result<(), AbortReason> {
        // From the setpoints, which are those of a posture or of a sweep that was aborted.
        let from: Vec<f64> = self.setpoints.iter().zip(&self.bias).map(|(sent, bias)| sent - bias).collect();
        let furthest = from.iter().zip(posture).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max);
        let cycles = (PEAK_OVER_MEAN * furthest / speed / self.period_s()).ceil() as u64;
        for k in 1..=cycles {
            let share = minimum_jerk(k as f64, cycles as f64)[0];
            for (i, held) in self.posture.iter_mut().enumerate() {
                *held = from[i] + share * (posture[i] - from[i]);
            }
            self.tick(0, 0.0)?;
        }
        self.posture.copy_from_slice(posture);
        self.find_bias()?;
        let distances = self.posture.iter().zip(&self.sample.q).map(|(held, q)| (q - held).abs());
        match distances.enumerate().find(|(_, distance)| *distance > NOT_REACHED) {
            Some((joint, distance)) => Err(AbortReason::NotReached { joint, distance }),
            None => Ok(()),
        }
    }

    /// Time between two control cycles, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        self.robot.capabilities().period_s
    }

    /// Number of control cycles so far.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Position at which a joint is held, rad (m).
    #[must_use]
    pub fn posture(&self, joint: usize) -> f64 {
        self.posture[joint]
    }

    /// Measured positions of all joints at the last control cycle (n; rad, m).
    #[must_use]
    pub fn positions(&self) -> &[f64] {
        &self.sample.q
    }

    /// Last setpoint of a joint, rad (m).
    #[must_use]
    pub fn setpoint(&self, joint: usize) -> f64 {
        self.setpoints[joint]
    }

    /// Setpoint that holds a joint at its posture, rad (m).
    fn held_setpoint(&self, joint: usize) -> f64 {
        self.posture[joint] + self.bias[joint]
    }

    /// Reads a sample and sends the setpoint (rad, m) of a joint; the other joints are held, also if their load changes slowly.
    /// Returns the setpoint (rad, m) that was in effect before the sample.
    ///
    /// # Errors
    /// If the robot fails, another joint does not hold its posture, or the run is interrupted.
    pub fn follow(&mut self, joint: usize, setpoint: f64) -> Result<f64, AbortReason> {
        let before = self.setpoints[joint];
        self.read()?;
        let share = self.period_s() / FOLLOWS_WEIGHT_S;
        for i in (0..self.posture.len()).filter(|i| *i != joint) {
            let distance = self.posture[i] - self.sample.q[i];
            if distance.abs() > NOT_REACHED {
                return Err(AbortReason::NotReached { joint: i, distance: distance.abs() });
            }
            self.bias[i] += share * (distance - distance.clamp(-HELD_WITHIN, HELD_WITHIN));
        }
        self.write(joint, setpoint)?;
        Ok(before)
    }

    /// Last measured motor torque, Nm (N).
    #[must_use]
    pub fn torque(&self, joint: usize) -> Option<f64> {
        self.sample.motor_torque.as_ref().map(|t| t[joint])
    }

    /// True if motor torque is measured.
    #[must_use]
    pub fn measures_torque(&self) -> bool {
        self.sample.motor_torque.is_some()
    }

    /// Holds all joints for this time (s).
    ///
    /// # Errors
    /// If the robot fails, or the run is interrupted.
    pub fn rest(&mut self, seconds: f64) -> Result<(), AbortReason> {
        for _ in 0..(seconds / self.period_s()).ceil() as u64 {
            self.tick(0, 0.0)?;
        }
        Ok(())
    }

    /// Moves a joint's setpoint along `offsets` (rad, m) from its posture; it stays at the last one. If the motion is
    /// aborted, the joint returns to its initial position.
    ///
    /// # Errors
    /// If a bound is exceeded, the robot fails, or the run is interrupted.
    pub fn run_trajectory(
        &mut self,
        joint: usize,
        offsets: impl Iterator<Item = f64>,
        bounds: &Bounds,
    ) -> Result<Record, AbortReason> {
        let over = ((SPEED_OVER_S / self.period_s()).round() as usize).max(1);
        let mut record = Record::default();
        let mut last = 0.0;
        for offset in offsets {
            let torque_before = self.tick(joint, offset)?;
            if !record.asked.is_empty() {
                record.torque.extend(torque_before);
            }
            record.asked.push(offset);
            record.position.push(self.sample.q[joint] - self.posture[joint]);
            last = offset;
            if let Some(stop) = self.out_of_bounds(&record, over, bounds) {
                self.rest(0.3)?;
                return Err(stop);
            }
        }
        // The torque of the last interval is part of the next sample.
        record.torque.extend(self.tick(joint, last)?);
        Ok(record)
    }

    fn out_of_bounds(&self, record: &Record, over: usize, bounds: &Bounds) -> Option<AbortReason> {
        let k = record.position.len() - 1;
        let here = record.position[k];
        let speed = if k >= over {
            (here - record.position[k - over]) / (over as f64 * self.period_s())
        } else {
            0.0
        };
        let torque = record.torque.last().copied().unwrap_or(0.0);
        if here.abs() > bounds.travel {
            Some(AbortReason::Travel(here))
        } else if speed.abs() > bounds.speed {
            Some(AbortReason::Speed(speed))
        } else if torque.abs() > bounds.torque {
            Some(AbortReason::Torque(torque))
        } else {
            None
        }
    }

    /// Reads a sample and sends the next setpoints; returns the measured torque, which belongs to the previous
    /// interval.
    fn tick(&mut self, joint: usize, offset: f64) -> Result<Option<f64>, AbortReason> {
        self.read()?;
        self.write(joint, self.held_setpoint(joint) + offset)?;
        Ok(self.torque(joint))
    }

    fn read(&mut self) -> Result<(), AbortReason> {
        self.ticks += 1;
        if (self.ended)(self.ticks) {
            return Err(AbortReason::Interrupted);
        }
        self.robot.read(&mut self.sample)?;
        if let Some(joint) = self.sample.q.iter().position(|q| !q.is_finite()) {
            return Err(AbortReason::NotFinite(joint));
        }
        for (i, kind) in self.kinds.iter().enumerate() {
            self.sample.q[i] = kind.nearest_turn(self.sample.q[i], self.posture[i]);
        }
        Ok(())
    }

    /// Sends the setpoint (rad, m) of a joint, with those that hold the others.
    fn write(&mut self, joint: usize, setpoint: f64) -> Result<(), AbortReason> {
        for i in 0..self.posture.len() {
            self.setpoints[i] = self.held_setpoint(i);
        }
        self.setpoints[joint] = setpoint;
        self.robot.write(Command::Position(&self.setpoints))?;
        Ok(())
    }
}
