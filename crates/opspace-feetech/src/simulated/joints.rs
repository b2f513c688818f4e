//! The joints behind simulated servos.

/// Joints that the motors of simulated servos move.
pub trait JointModel: Send {
    /// Number of joints.
    fn joints(&self) -> usize;

    /// Advances the joints by a duration (s) with constant motor torques at the joints (n; Nm).
    fn advance(&mut self, motor_torque_nm: &[f64], duration_s: f64);

    /// Positions (n; rad).
    fn q(&self) -> &[f64];

    /// Velocities (n; rad/s).
    fn dq(&self) -> &[f64];

    /// Reason why the joints are not simulated any more; `None` while they are.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// One joint of [`SeparateJoints`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeparateJoint {
    /// Inertia with the rotor, kg m².
    pub inertia_kg_m2: f64,
    /// Viscous friction with the motor's own voltage, Nms/rad.
    pub damping_nms_per_rad: f64,
    /// Coulomb friction, Nm.
    pub coulomb_nm: f64,
    /// Torque of the weight at q = 0, Nm; it is proportional to cos q, and negative if it pulls to smaller positions.
    pub weight_nm: f64,
    /// Other external torque, Nm.
    pub external_nm: f64,
    /// Mechanical ends, rad.
    pub ends_rad: (f64, f64),
}

impl Default for SeparateJoint {
    /// Friction, damping and rotor of the STS3215 at 7.4 V, as SO-ARM100 publishes them, and the rotor's inertia again as
    /// that of the link.
    fn default() -> Self {
        Self {
            inertia_kg_m2: 0.056,
            damping_nms_per_rad: 0.60,
            coulomb_nm: 0.052,
            weight_nm: 0.0,
            external_nm: 0.0,
            ends_rad: (-1.9, 1.9),
        }
    }
}

/// Joints that do not act on one another.
#[derive(Clone, Debug)]
pub struct SeparateJoints {
    /// Parameters of the joints.
    pub parameters: Vec<SeparateJoint>,
    q: Vec<f64>,
    dq: Vec<f64>,
}

impl SeparateJoints {
    /// Returns joints at rest at these positions (rad).
    #[must_use]
    pub fn new(parameters: Vec<SeparateJoint>, q: &[f64]) -> Self {
        let mut q = q.to_vec();
        q.resize(parameters.len(), 0.0);
        Self { dq: vec![0.0; q.len()], parameters, q }
    }
}

impl JointModel for SeparateJoints {
    fn joints(&self) -> usize {
        self.q.len()
    }

    /// Integrates m q̈ = τ + g cos q + τ_external − d q̇ − c sign(q̇), with damping and friction at the end of the step, so
    /// that neither adds energy.
    fn advance(&mut self, motor_torque_nm: &[f64], duration_s: f64) {
        for (index, joint) in self.parameters.iter().enumerate() {
            let torque = motor_torque_nm.get(index).copied().unwrap_or(0.0)
                + joint.weight_nm * self.q[index].cos()
                + joint.external_nm;
            let inertia = joint.inertia_kg_m2 + joint.damping_nms_per_rad * duration_s;
            let free = (joint.inertia_kg_m2 * self.dq[index] + torque * duration_s) / inertia;
            let friction = joint.coulomb_nm * duration_s / inertia;
            let velocity = free.signum() * (free.abs() - friction).max(0.0);
            let position = self.q[index] + velocity * duration_s;
            self.q[index] = position.clamp(joint.ends_rad.0, joint.ends_rad.1);
            self.dq[index] = if position == self.q[index] { velocity } else { 0.0 };
        }
    }

    fn q(&self) -> &[f64] {
        &self.q
    }

    fn dq(&self) -> &[f64] {
        &self.dq
    }
}
