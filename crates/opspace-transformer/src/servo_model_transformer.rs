//! Conversion of torques to positions or velocities by emulating the servo between two interface cycles.
//!
//! Equation (K10) of the paper is exact only at the instant at which the drive receives the setpoint: a servo that runs
//! R times faster then combines the same setpoint with later positions. This transformer emulates every servo tick up
//! to the next setpoint with the drive's own law, on the arm in its present state. The torques at the R servo ticks at
//! which the setpoint acts are
//!
//! ```text
//! τ_j = Y₀_j + Y₁_j q_d        j = 0 … R − 1
//! ```
//!
//! For drives that accept velocities, read q̇_d for q_d here and below.
//!
//! Y₀ is the torque due to the state and the previous setpoint, Y₁ (n × n) the torque per unit of setpoint. For a drive
//! that holds its setpoint, the **mean** torque equals the desired torque. For a drive that interpolates, the torques
//! of **all** servo ticks match the desired torque in the least-squares sense:
//!
//! ```text
//! Σ Y₁_j q_d = Σ (τ − δ − Y₀_j)        Σ Y₁_jᵀ Y₁_j q_d = Σ Y₁_jᵀ (τ − δ − Y₀_j)
//! ```
//!
//! The state at the end of the emulated interval is the prediction of the [observer](crate::observer), which therefore
//! includes the motion of the drive within the interval. δ is the excess of the motor torque over the emulated torque,
//! if the current is [measured](crate::current).

use crate::active_setpoints::ActiveSetpoints;
use crate::current::CurrentObserver;
use crate::drive_timing::DriveTiming;
use crate::friction::FrictionCompensation;
use crate::gain_adaptation::{GainAdaptation, GainAdaptationParameters};
use crate::observer::{ObservedJoint, ObserverGain};
use crate::remaining_damping::RemainingDamping;
use crate::servo::ServoParameters;
use crate::servo_gains::ServoGains;
use crate::servo_inversion::{EmulationError, TorqueObjective, check_inverse};
use crate::servo_law::{MAX_ORDER, ServoLaw, ServoState};
use crate::setpoint_average::SetpointAverage;
use crate::transformer::Transformer;
use nalgebra::{DMatrix, DVector};
use opspace_backend::{CommandKind, GravityCompensation, Sample, Setpoints};
use opspace_model::Data;

/// Parameters of the emulation: servos, joints and timing of the robot.
#[derive(Clone, Debug)]
pub struct EmulationSetup {
    /// Servos (n): either all position servos or all velocity servos.
    pub servos: Vec<ServoParameters>,
    /// Nominal joint friction, with a compensation gain of 1.
    pub friction: FrictionCompensation,
    /// Resolution of each encoder at the joint (n; rad, m).
    pub resolution_rad: Vec<f64>,
    /// Inertia that each drive moves in a representative posture (n; kg m², kg), for the observer's gain.
    pub inertias: Vec<f64>,
    /// Torque limit of each drive (n; Nm, N).
    pub torque_limits: Vec<f64>,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface cycle.
    pub servo_ticks_per_cycle: u32,
    /// Delay until a setpoint acts, in servo ticks.
    pub delay: u32,
    /// Behaviour of the drives between two setpoints: hold or interpolate.
    pub setpoints: Setpoints,
    /// Torques that are matched: the mean torque, or the torque of each servo tick.
    pub matching: TorqueObjective,
    /// Side that compensates gravity: the robot or the controller.
    pub gravity_compensated_by: GravityCompensation,
    /// True if brakes hold a velocity robot, with motors off, until its first setpoint acts. Ignored for a position
    /// robot, which its servos hold.
    pub has_brakes: bool,
    /// Damping that is left to each joint (n), because the true gains are not known exactly.
    pub remaining_damping: Vec<RemainingDamping>,
    /// True if measured motor torques are used.
    pub current: bool,
    /// Adaptation of gains from measured motor torques, if any; not applied to velocity servos.
    pub adapt_gains: Option<GainAdaptationParameters>,
}

/// Transformer that emulates the servo: see the [module](self).
#[derive(Clone, Debug)]
pub struct EmulatingTransformer {
    /// Quantity of the setpoints.
    takes: CommandKind,
    drives: Vec<Drive>,
    friction: FrictionCompensation,
    ticks: DriveTiming,
    matching: TorqueObjective,
    gravity_compensated_by: GravityCompensation,
    has_brakes: bool,
    current: Option<CurrentObserver>,
    /// Estimated state of the arm and its drives at the present interface cycle.
    state: State,
    /// State predicted for the next interface cycle.
    predicted: State,
    rollout: State,
    /// Unmodelled joint accelerations (n; rad/s², m/s²).
    disturbance: DVector<f64>,
    in_force: ActiveSetpoints,
    /// Velocities of the references (n; rad/s, m/s).
    reference_velocity: Vec<f64>,
    /// True after the first setpoint was sent; before, the robot holds itself.
    begun: bool,
    /// Servo ticks until brakes that hold the robot are released, counted from the present interface cycle.
    braked_ticks: u32,
    /// M⁻¹ (n × n), and the accelerations without motor torque (n; rad/s², m/s²).
    mass_inverse: DMatrix<f64>,
    free: DVector<f64>,
    /// True if `mass_inverse` and `free` are valid for the present interface cycle.
    frozen: bool,
    /// Y₁, and desired torque minus Y₀, for each servo tick.
    responses: Vec<DMatrix<f64>>,
    missing: Vec<DVector<f64>>,
    normal: DMatrix<f64>,
    solution: DVector<f64>,
    /// Mean emulated torque since the last sample (n; Nm, N), over `intervals` interface intervals.
    mean_torque: DVector<f64>,
    intervals: f64,
    /// Mean emulated position error since the last sample (n; rad, m); used for position servos only.
    mean_error: DVector<f64>,
    /// Zero acceleration (n).
    rest: DVector<f64>,
    /// Zero excess torque (n).
    none: DVector<f64>,
}

#[derive(Clone, Debug)]
struct Drive {
    law: ServoLaw,
    torque_limit: f64,
    /// Damping that is left to the joint.
    remaining_damping: RemainingDamping,
    gain: ObserverGain,
    adapted: Option<AdaptedDrive>,
}

/// Drive whose gains are adapted while it runs: nominal and present gains.
#[derive(Clone, Copy, Debug)]
struct AdaptedDrive {
    adaptation: GainAdaptation,
    nominal: ServoGains,
    now: ServoGains,
}

impl AdaptedDrive {
    /// Updates the gains with the measured mean torque; `emulated` is the torque expected with the previous gains,
    /// `error` the mean position error. Returns the torque expected with the new gains (Nm, N).
    fn update(&mut self, law: &mut ServoLaw, measured: f64, emulated: f64, error: f64) -> f64 {
        let (before, believed) = (self.now, self.nominal);
        let velocity = (before.stiffness * error - emulated) / before.damping;
        let [stiffness, damping, _] =
            self.adaptation.update(measured, [believed.stiffness * error, believed.damping * velocity, 0.0]);
        self.now =
            ServoGains { stiffness: stiffness * believed.stiffness, damping: damping * believed.damping };
        law.retune(before, self.now);
        self.now.stiffness * error - self.now.damping * velocity
    }
}

/// State of the arm and of the memory of its drives, at a servo tick.
#[derive(Clone, Debug)]
struct State {
    q: DVector<f64>,
    dq: DVector<f64>,
    memory: Vec<ServoState>,
    /// Moving averages of the drives' setpoints.
    averages: Vec<SetpointAverage>,
    /// Averaged setpoints of the last servo tick (n; rad, m or rad/s, m/s).
    setpoint: DVector<f64>,
    torque: DVector<f64>,
}

impl State {
    fn new(drives: &[Drive]) -> Self {
        let zero = DVector::zeros(drives.len());
        Self {
            q: zero.clone(),
            dq: zero.clone(),
            memory: vec![[0.0; MAX_ORDER]; drives.len()],
            averages: drives.iter().map(|drive| drive.law.setpoint_average()).collect(),
            setpoint: zero.clone(),
            torque: zero,
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.q.copy_from(&other.q);
        self.dq.copy_from(&other.dq);
        self.memory.copy_from_slice(&other.memory);
        self.averages.iter_mut().zip(&other.averages).for_each(|(to, from)| to.copy_from(from));
        self.torque.copy_from(&other.torque);
    }

    fn clear(&mut self) {
        [&mut self.q, &mut self.dq, &mut self.torque].into_iter().for_each(|v| v.fill(0.0));
        self.memory.fill([0.0; MAX_ORDER]);
        self.averages.iter_mut().for_each(|average| average.rest(0.0));
    }

    /// Computes the drives' torques at this servo tick for their setpoints, without limits.
    fn drive(&mut self, drives: &[Drive], setpoint: impl Fn(usize) -> f64) {
        for (i, drive) in drives.iter().enumerate() {
            self.setpoint[i] = self.averages[i].step(setpoint(i));
            self.torque[i] = drive.law.step(&mut self.memory[i], self.setpoint[i], self.q[i]);
        }
    }

    /// Integrates over a servo period under these torques and the accelerations `free`.
    fn travel(&mut self, mass_inverse: &DMatrix<f64>, free: &DVector<f64>, period_s: f64) {
        let n = self.q.len();
        for i in 0..n {
            self.q[i] += period_s * (self.dq[i] + 0.5 * period_s * free[i]);
            self.dq[i] += period_s * free[i];
        }
        for (column, &torque) in mass_inverse.as_slice().chunks_exact(n).zip(&self.torque) {
            let (v, x) = (period_s * torque, 0.5 * period_s * period_s * torque);
            for ((q, dq), m) in self.q.iter_mut().zip(&mut self.dq).zip(column) {
                *q += x * m;
                *dq += v * m;
            }
        }
    }
}

impl EmulatingTransformer {
    /// Returns the transformer for a robot at rest.
    ///
    /// # Errors
    /// Index of the first joint whose servo cannot be emulated or inverted, and the reason.
    pub fn new(setup: &EmulationSetup) -> Result<Self, (usize, EmulationError)> {
        let n = setup.servos.len();
        let ticks = DriveTiming {
            servo_period_s: setup.servo_period_s,
            servo_ticks_per_cycle: setup.servo_ticks_per_cycle,
            delay: setup.delay,
            setpoints: setup.setpoints,
        };
        let interface_s = f64::from(setup.servo_ticks_per_cycle) * setup.servo_period_s;
        let takes = setup.servos.first().map_or(CommandKind::Position, ServoParameters::takes);
        let drive = |i: usize| -> Result<Drive, EmulationError> {
            let kind = setup.servos[i].takes();
            if kind != takes {
                return Err(EmulationError::Mixed { takes: kind, others: takes });
            }
            let law = ServoLaw::new(&setup.servos[i], setup.servo_period_s)?;
            check_inverse(&law, ticks, setup.matching)?;
            let gain = ObserverGain::steady(&ObservedJoint {
                servo: Some(&law),
                inertia: setup.inertias[i],
                resolution_rad: setup.resolution_rad[i],
                servo_period_s: setup.servo_period_s,
                servo_ticks_per_cycle: setup.servo_ticks_per_cycle,
            });
            let servo = &setup.servos[i];
            let adapt = setup.adapt_gains.filter(|_| setup.current && servo.has_two_gains());
            let adapted = adapt.map(|parameters| {
                let gains = servo.gains(setup.servo_period_s);
                let adaptation = GainAdaptation::new(&parameters, setup.torque_limits[i], interface_s);
                AdaptedDrive { adaptation, nominal: gains, now: gains }
            });
            let (torque_limit, remaining_damping) = (setup.torque_limits[i], setup.remaining_damping[i]);
            Ok(Drive { law, torque_limit, remaining_damping, gain, adapted })
        };
        let drives: Vec<Drive> = (0..n).map(|i| drive(i).map_err(|e| (i, e))).collect::<Result<_, _>>()?;
        let zero = DVector::zeros(n);
        let matrix = DMatrix::zeros(n, n);
        let each_tick = setup.servo_ticks_per_cycle as usize;
        Ok(Self {
            takes,
            friction: setup.friction.clone(),
            ticks,
            matching: setup.matching,
            gravity_compensated_by: setup.gravity_compensated_by,
            has_brakes: setup.has_brakes && takes == CommandKind::Velocity,
            current: setup.current.then(|| CurrentObserver::new(&setup.torque_limits)),
            state: State::new(&drives),
            predicted: State::new(&drives),
            rollout: State::new(&drives),
            drives,
            disturbance: zero.clone(),
            in_force: ActiveSetpoints::new(n, ticks),
            reference_velocity: vec![0.0; n],
            begun: false,
            braked_ticks: 0,
            mass_inverse: matrix.clone(),
            free: zero.clone(),
            frozen: false,
            responses: vec![matrix.clone(); each_tick],
            missing: vec![zero.clone(); each_tick],
            normal: matrix,
            solution: zero.clone(),
            mean_torque: zero.clone(),
            intervals: 0.0,
            mean_error: zero.clone(),
            rest: zero.clone(),
            none: zero,
        })
    }

    fn torque_disturbance(&self) -> &DVector<f64> {
        self.current.as_ref().map_or(&self.none, CurrentObserver::torque_disturbance)
    }

    /// Corrects the predicted state with the measured positions.
    fn correct(&mut self, sample: &Sample) {
        self.state.copy_from(&self.predicted);
        for (i, drive) in self.drives.iter().enumerate() {
            let innovation = sample.q[i] - self.state.q[i];
            self.state.q[i] += drive.gain.position * innovation;
            self.state.dq[i] += drive.gain.velocity * innovation;
            self.disturbance[i] += drive.gain.disturbance * innovation;
            for (value, share) in self.state.memory[i].iter_mut().zip(&drive.gain.memory) {
                *value += share * innovation;
            }
        }
        let (Some(current), Some(measured)) = (&mut self.current, &sample.motor_torque) else { return };
        // The gains are adapted first; δ then contains only the remaining difference.
        for (i, drive) in self.drives.iter_mut().enumerate() {
            if let Some(adapted) = &mut drive.adapted {
                let (torque, error) = (&mut self.mean_torque[i], self.mean_error[i]);
                *torque = adapted.update(&mut drive.law, measured[i], *torque, error);
            }
        }
        current.update(measured, &self.mean_torque);
    }

    /// Computes M⁻¹ and the accelerations without motor torque in the present state; both are held constant over the
    /// interval.
    fn freeze(&mut self, data: &Data) {
        if self.frozen {
            return;
        }
        self.frozen = true;
        self.mass_inverse.fill_with_identity();
        data.mass_matrix_factor.solve_matrix(&mut self.mass_inverse);
        for i in 0..self.free.len() {
            let carried =
                if self.gravity_compensated_by == GravityCompensation::Robot { data.gravity[i] } else { 0.0 };
            let friction = self.friction.torque(i, self.state.dq[i]);
            self.free[i] = self.torque_disturbance()[i] + carried - data.bias[i] - friction;
            if !self.begun {
                // The robot holds itself: its drives hold its weight at rest, or no load if brakes hold it.
                let load = if self.has_brakes { 0.0 } else { data.gravity[i] - carried };
                self.hold(i, load);
            }
        }
        data.mass_matrix_factor.solve(self.free.as_mut_slice());
        self.free += &self.disturbance;
    }

    /// Sets the drive of a joint to rest at the present position, with this torque (Nm, N).
    fn hold(&mut self, joint: usize, torque: f64) {
        let law = &self.drives[joint].law;
        let (memory, setpoint) = law.rest(self.state.q[joint], torque);
        self.state.memory[joint] = memory;
        self.state.averages[joint].rest(setpoint);
        self.in_force.hold(joint, setpoint);
    }

    /// Servo ticks, counted from the present interface cycle, at which brakes hold the robot: until the first setpoints act,
    /// which are those of this cycle or are sent already.
    fn braked_ticks(&self) -> u32 {
        match (self.has_brakes, self.begun) {
            (false, _) => 0,
            (true, false) => self.ticks.delay,
            (true, true) => self.braked_ticks,
        }
    }

    /// Computes the drives' torques at one servo tick under the previous setpoint.
    fn roll_old(&mut self, tick: u32) {
        let (in_force, ticks) = (&self.in_force, self.ticks);
        self.rollout.drive(&self.drives, |i| in_force.at(ticks, i, tick));
    }

    /// Computes Y₁ at every servo tick, column by column, from the linear response of the drives and the arm.
    fn respond(&mut self) {
        let ticks = self.ticks;
        for joint in 0..self.drives.len() {
            self.rollout.clear();
            for (tick, response) in (0..ticks.servo_ticks_per_cycle).zip(&mut self.responses) {
                let unit = ticks.setpoints.at(0.0, 1.0, tick, ticks.servo_ticks_per_cycle);
                self.rollout.drive(&self.drives, |i| if i == joint { unit } else { 0.0 });
                response.column_mut(joint).copy_from(&self.rollout.torque);
                self.rollout.travel(&self.mass_inverse, &self.rest, ticks.servo_period_s);
            }
        }
    }

    /// Assembles the linear system for the setpoint, from Y₁ and the missing torque.
    fn assemble(&mut self) {
        self.normal.fill(0.0);
        self.solution.fill(0.0);
        for (response, missing) in self.responses.iter().zip(&self.missing) {
            match self.matching {
                TorqueObjective::IntervalMean => {
                    self.normal += response;
                    self.solution += missing;
                }
                TorqueObjective::PerTick => {
                    self.normal.gemm_tr(1.0, response, response, 1.0);
                    self.solution.gemv_tr(1.0, response, missing, 1.0);
                }
            }
        }
    }

    /// Predicts the state at the next interface cycle for these setpoints, sent at the present one. With `None`, the
    /// drives keep their last setpoints.
    fn predict(&mut self, q_desired: Option<&[f64]>) {
        let ticks = self.ticks;
        let share = 1.0 / f64::from(ticks.servo_ticks_per_cycle);
        let braked_ticks = self.braked_ticks();
        self.braked_ticks = braked_ticks.saturating_sub(ticks.servo_ticks_per_cycle);
        self.rollout.copy_from(&self.state);
        if self.intervals == 0.0 {
            self.mean_torque.fill(0.0);
            self.mean_error.fill(0.0);
        }
        self.mean_torque *= self.intervals;
        self.mean_error *= self.intervals;
        for tick in braked_ticks..ticks.servo_ticks_per_cycle {
            let in_force = &self.in_force;
            self.rollout.drive(&self.drives, |i| in_force.during(ticks, i, tick, q_desired));
            for (i, error) in self.mean_error.iter_mut().enumerate() {
                *error += share * (self.rollout.setpoint[i] - self.rollout.q[i]);
            }
            // The limit applies to the motor torque, which is the emulated torque plus δ.
            for (i, drive) in self.drives.iter().enumerate() {
                let more = self.current.as_ref().map_or(0.0, |current| current.torque_disturbance()[i]);
                let torque = &mut self.rollout.torque[i];
                *torque = torque.clamp(-drive.torque_limit - more, drive.torque_limit - more);
                self.mean_torque[i] += share * *torque;
            }
            self.rollout.travel(&self.mass_inverse, &self.free, ticks.servo_period_s);
        }
        self.intervals += 1.0;
        self.mean_torque /= self.intervals;
        self.mean_error /= self.intervals;
        self.predicted.copy_from(&self.rollout);
        self.in_force.advance(ticks, q_desired);
    }
}

impl Transformer for EmulatingTransformer {
    fn takes(&self) -> CommandKind {
        self.takes
    }

    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        self.friction.advance(&sample.q);
        if !self.begun {
            self.state.clear();
            self.state.q.copy_from_slice(&sample.q);
        } else {
            // No setpoint was sent since the last sample.
            if !self.frozen {
                self.predict(None);
            }
            self.correct(sample);
        }
        self.frozen = false;
        self.intervals = 0.0;
        Some(self.state.dq.as_slice())
    }

    fn uses_reference_motion(&self) -> bool {
        self.drives.iter().any(|drive| drive.remaining_damping.along_reference > 0.0)
    }

    fn is_damped(&self) -> bool {
        self.drives.iter().any(|drive| drive.remaining_damping.damping > 0.0)
    }

    fn damping_torque(&self, velocity: &[f64], torques: &mut [[f64; 2]]) {
        let references = self.reference_velocity.iter().zip(velocity);
        for (torques, (drive, (reference, v))) in torques.iter_mut().zip(self.drives.iter().zip(references)) {
            *torques = drive.remaining_damping.torques(*v, *reference);
        }
    }

    fn set_reference_motion(&mut self, velocity: &[f64], _acceleration: &[f64]) {
        self.reference_velocity.copy_from_slice(velocity);
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        self.freeze(data);
        self.respond();
        let ticks = self.ticks;
        self.rollout.copy_from(&self.state);
        for tick in self.braked_ticks()..ticks.delay {
            self.roll_old(tick);
            self.rollout.travel(&self.mass_inverse, &self.free, ticks.servo_period_s);
        }
        // Y₀ is computed with the measured positions or velocities as setpoints, so that the solution is a small
        // difference with little rounding.
        let about = if self.takes == CommandKind::Velocity { &data.dq } else { &data.q };
        q_desired.copy_from_slice(about.as_slice());
        for tick in 0..ticks.servo_ticks_per_cycle {
            let in_force = &self.in_force;
            self.rollout.drive(&self.drives, |i| {
                ticks.setpoints.at(in_force.left(ticks, i), about[i], tick, ticks.servo_ticks_per_cycle)
            });
            for (i, tau) in tau.iter().enumerate() {
                let damping = self.drives[i].remaining_damping;
                let left = damping.torque(self.rollout.dq[i], self.reference_velocity[i]);
                self.missing[tick as usize][i] =
                    tau - left - self.torque_disturbance()[i] - self.rollout.torque[i];
            }
            self.rollout.travel(&self.mass_inverse, &self.free, ticks.servo_period_s);
        }
        self.assemble();
        eliminate(&mut self.normal, self.solution.as_mut_slice());
        for (qd, more) in q_desired.iter_mut().zip(&self.solution) {
            *qd += more;
        }
    }

    fn sent(&mut self, data: &Data, q_desired: &[f64]) {
        self.freeze(data);
        self.predict(Some(q_desired));
        self.begun = true;
    }

    fn missed(&mut self, periods: u64) {
        if !self.begun {
            return;
        }
        if !self.frozen {
            self.predict(None);
        }
        for _ in 0..periods {
            self.state.copy_from(&self.predicted);
            self.predict(None);
        }
        self.frozen = true;
    }

    fn reset(&mut self) {
        self.begun = false;
        self.reference_velocity.fill(0.0);
        self.friction.reset();
        self.disturbance.fill(0.0);
        if let Some(current) = &mut self.current {
            current.reset();
        }
        self.in_force.settle(self.ticks);
    }
}

/// Solves A x = b by Gaussian elimination without pivoting: x overwrites b, and A (n × n) is modified. A is diagonally
/// dominant: a setpoint affects its own drive more than the other drives, which it affects only through the arm.
fn eliminate(a: &mut DMatrix<f64>, b: &mut [f64]) {
    let n = b.len();
    for k in 0..n {
        for r in k + 1..n {
            let factor = a[(r, k)] / a[(k, k)];
            for c in k..n {
                a[(r, c)] -= factor * a[(k, c)];
            }
            b[r] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|c| a[(k, c)] * b[c]).sum();
        b[k] = (b[k] - known) / a[(k, k)];
    }
}
