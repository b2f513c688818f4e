//! Variations of a simulated arm: true values that differ from the nominal ones, equally for all joints.

use opspace_backend::quantity::Positive;
use opspace_sim::ArmConfig;
use opspace_transformer::ServoParameters;

/// True value that differs from the nominal one by a factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variation {
    /// Gain of the position loops.
    PositionGain,
    /// Gain of the velocity loops.
    VelocityGain,
    /// Cut-off frequency of the servos' velocity filters.
    VelocityFilter,
    /// Inertia and mass of the links and rotors.
    Inertia,
    /// Stiffness of the elastic gears.
    GearStiffness,
}

impl Variation {
    /// Name in tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PositionGain => "gain of position loops",
            Self::VelocityGain => "gain of velocity loops",
            Self::VelocityFilter => "velocity filter of drives",
            Self::Inertia => "inertia",
            Self::GearStiffness => "gear stiffness",
        }
    }

    /// Returns the arm with `factor` times the nominal value; `None` if it has no such value.
    pub(super) fn of(self, nominal: &ArmConfig, factor: f64) -> Option<ArmConfig> {
        let factor = Positive::try_from(factor).ok()?;
        let mut arm = nominal.clone();
        let scale = &mut arm.simulated.true_over_nominal;
        match self {
            Self::PositionGain => scale.kp = factor,
            Self::VelocityGain => scale.kv = factor,
            Self::Inertia => scale.inertia = factor,
            Self::GearStiffness => scale.gear_stiffness = factor,
            Self::VelocityFilter => filter(&mut arm, factor.get())?,
        }
        Some(arm)
    }
}

/// Returns the arm whose setpoints act `ticks` servo ticks after they are sent.
pub(super) fn delayed(nominal: &ArmConfig, ticks: u32) -> ArmConfig {
    let mut arm = nominal.clone();
    arm.simulated.delay_servo_ticks = Some(ticks);
    arm
}

/// Multiplies the cut-off frequencies of the true servos; `None` if a servo has no such filter.
fn filter(arm: &mut ArmConfig, factor: f64) -> Option<()> {
    for (joint, nominal) in arm.model.joints().iter().zip(&arm.servos) {
        let mut servo = nominal.clone();
        let cut_off = servo.structure_mut().velocity_filter_hz()?;
        *cut_off = Positive::try_from(factor * cut_off.get()).ok()?;
        match servo {
            ServoParameters::Velocity(servo) => {
                arm.simulated.velocity_servo.insert(joint.name.clone(), servo);
            }
            servo => {
                arm.simulated.servo.insert(joint.name.clone(), servo);
            }
        }
    }
    Some(())
}
