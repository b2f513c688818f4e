//! Identified servo: estimates from the points of a joint, the conditions under which they are accepted, and those with a hung weight.

use super::failure::StaticFailure;
use super::fit::{Fit, Stiffness, fit};
use super::parameters::StaticParameters;
use super::sweep::{StaticPoint, gravity_span};
use crate::confidence::Interval95;
use serde::Serialize;

/// Least span of the torque of gravity over Coulomb friction from which stiffness is identified.
pub const LEAST_SPAN: f64 = 4.0;

/// Ratio between identified and declared stiffness, by the nearer end of the interval, above which the servo is refused.
const STIFFNESS_REFUSED: f64 = 1.2;

/// Largest half-width of the interval of a stiffness, as a fraction of it.
const WIDEST: f64 = 0.1;

/// Relative error of a stiffness that is taken from another joint: servos of one model differ.
const SERVOS_WITHIN: f64 = 0.03;

/// Largest rms error of the fit, in resolutions, and as a fraction of the span of the offsets.
const EXPLAINED_COUNTS: f64 = 3.0;
const EXPLAINED: f64 = 0.05;

/// Identified servo without a velocity loop.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct StaticServo {
    /// Stiffness, Nm/rad (N/m).
    pub stiffness: f64,
    /// 95 % interval of the stiffness.
    pub stiffness_interval: Interval95,
    /// Joint from which the ratio to the declared stiffness is taken; `None` if it was measured.
    pub stiffness_from: Option<usize>,
    /// Coulomb friction, Nm (N).
    pub coulomb: f64,
    /// 95 % interval of Coulomb friction.
    pub coulomb_interval: Interval95,
    /// Viscous friction, without the declared damping of the servo, Nms/rad (Ns/m).
    pub viscous: f64,
    /// 95 % interval of viscous friction.
    pub viscous_interval: Interval95,
    /// Span of the torque of gravity over the motion, Nm (N).
    pub gravity_span: f64,
    /// Rms error of the offsets, rad (m).
    pub residual: f64,
    /// Estimates with a hung weight.
    pub hung_weight: Option<HungWeight>,
    /// Measured offsets.
    pub points: Vec<StaticPoint>,
}

/// Estimates from the difference that a hung weight of known mass makes.
#[derive(Clone, Copy, Debug, Serialize)]
#[non_exhaustive]
pub struct HungWeight {
    /// Stiffness without the masses of the URDF, Nm/rad (N/m).
    pub stiffness: f64,
    /// 95 % interval of this stiffness.
    pub stiffness_interval: Interval95,
    /// Masses over those of the URDF.
    pub mass_scale: f64,
    /// 95 % interval of this ratio.
    pub mass_scale_interval: Interval95,
}

impl HungWeight {
    /// True if the masses of the URDF are confirmed.
    #[must_use]
    pub fn agrees(&self) -> bool {
        (self.mass_scale_interval.lower..=self.mass_scale_interval.upper).contains(&1.0)
    }
}

/// Estimates from the points of a joint.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Servo, for information only if `refused` gives a reason.
    pub servo: Option<StaticServo>,
    /// Reason why it is not identified.
    pub refused: Option<StaticFailure>,
    /// Reasons to doubt the results.
    pub doubts: Vec<String>,
}

/// Identifies the servo of a joint from its points.
#[must_use]
pub fn evaluate(known: &StaticParameters, points: Vec<StaticPoint>) -> Evaluation {
    let span = gravity_span(&points);
    let free = fit(&points, known, Stiffness::Free);
    let determined = free.filter(|fit| relative(fit) <= WIDEST);
    let coulomb = determined.as_ref().map(|fit| fit.coulomb);
    let free = determined.filter(|fit| span >= LEAST_SPAN * fit.coulomb);
    let is_enough = free.is_some();
    // A slope that gravity hardly determines would scale friction, too.
    let found = if is_enough { free } else { fit(&points, known, Stiffness::Given(known.stiffness)) };
    let Some(found) = found else {
        return Evaluation { servo: None, refused: Some(StaticFailure::DoesNotFollow), doubts: Vec::new() };
    };
    let servo = servo(known, &found, None, points);
    let refused = match is_enough {
        false => Some(StaticFailure::TooLittleGravity { span, coulomb: coulomb.unwrap_or(servo.coulomb) }),
        true => check_declared(known, servo.stiffness, servo.stiffness_interval),
    };
    let doubts = doubt_fit(known, &servo);
    Evaluation { servo: Some(servo), refused, doubts }
}

/// Takes the ratio of identified to declared stiffness of the joint `from` for a joint on which gravity has too little effect.
pub fn take_stiffness(
    evaluation: &mut Evaluation,
    known: &StaticParameters,
    from: &StaticParameters,
    donor: &StaticServo,
) {
    let Some(previous) = evaluation.servo.take() else { return };
    let ratio = known.stiffness / from.stiffness;
    let interval = donor.stiffness_interval.scaled(ratio);
    let widened = Interval95 {
        lower: interval.lower / (1.0 + SERVOS_WITHIN),
        upper: interval.upper * (1.0 + SERVOS_WITHIN),
    };
    let stiffness = donor.stiffness * ratio;
    let Some(mut found) = fit(&previous.points, known, Stiffness::Given(stiffness)) else {
        evaluation.servo = Some(previous);
        return;
    };
    let relative = widened.half_width() / stiffness;
    found.stiffness_interval = widened;
    for (value, interval) in
        [(found.coulomb, &mut found.coulomb_interval), (found.viscous, &mut found.viscous_interval)]
    {
        let half = interval.half_width().hypot(relative * value);
        *interval = Interval95 { lower: value - half, upper: value + half };
    }
    evaluation.refused = None;
    let servo = servo(known, &found, Some(from.joint), previous.points);
    evaluation.doubts = doubt_fit(known, &servo);
    evaluation.servo = Some(servo);
}

/// Adds the estimates of the points without and with a hung weight. They need no masses of the URDF: a stiffness that they show is
/// accepted, also if it is not the declared one, or if gravity alone does not show it.
pub fn add_hung_weight(evaluation: &mut Evaluation, known: &StaticParameters, with: &[StaticPoint]) {
    let Some(servo) = &mut evaluation.servo else { return };
    let all: Vec<StaticPoint> = servo.points.iter().chain(with).cloned().collect();
    let Some(found) = fit(&all, known, Stiffness::FreeWithMasses) else { return };
    let Some((mass_scale, mass_scale_interval)) = found.mass_scale else { return };
    servo.points = all;
    let half_width = relative(&found);
    if half_width.is_nan() || half_width > WIDEST {
        evaluation.doubts.push(format!(
            "the hung weight determines its stiffness only within {:.0} %: it checks nothing",
            100.0 * half_width
        ));
        return;
    }
    let hung = HungWeight {
        stiffness: found.stiffness,
        stiffness_interval: found.stiffness_interval,
        mass_scale,
        mass_scale_interval,
    };
    servo.hung_weight = Some(hung);
    let is_measured = !matches!(evaluation.refused, Some(StaticFailure::TooLittleGravity { .. }));
    if is_measured && !hung.agrees() {
        evaluation.doubts.push(format!(
            "according to the hung weight, the masses that it carries are {mass_scale:.2} times those of the URDF; the stiffness that \
             does not depend on them, {:.3} Nm/rad, is written",
            hung.stiffness
        ));
    }
    if !is_measured || !hung.agrees() {
        servo.stiffness = found.stiffness;
        servo.stiffness_interval = found.stiffness_interval;
        (servo.coulomb, servo.coulomb_interval) = (found.coulomb, found.coulomb_interval);
        (servo.viscous, servo.viscous_interval) =
            (found.viscous - known.damping, found.viscous_interval.shifted(-known.damping));
    }
    evaluation.refused = None;
    if let Some(StaticFailure::NotAsDeclared { ratio }) =
        check_declared(known, servo.stiffness, servo.stiffness_interval)
    {
        evaluation
            .doubts
            .push(format!("the hung weight shows that its stiffness is {ratio:.2} times the declared one"));
    }
}

fn servo(
    known: &StaticParameters,
    found: &Fit,
    from: Option<usize>,
    points: Vec<StaticPoint>,
) -> StaticServo {
    StaticServo {
        stiffness: found.stiffness,
        stiffness_interval: found.stiffness_interval,
        stiffness_from: from,
        coulomb: found.coulomb,
        coulomb_interval: found.coulomb_interval,
        viscous: found.viscous - known.damping,
        viscous_interval: found.viscous_interval.shifted(-known.damping),
        gravity_span: gravity_span(&points),
        residual: found.residual,
        hung_weight: None,
        points,
    }
}

/// Half-width of the interval of the stiffness as a fraction of it.
fn relative(fit: &Fit) -> f64 {
    fit.stiffness_interval.half_width() / fit.stiffness
}

fn check_declared(known: &StaticParameters, stiffness: f64, interval: Interval95) -> Option<StaticFailure> {
    let near = known.stiffness.max(interval.lower).min(interval.upper) / known.stiffness;
    let ratio = stiffness / known.stiffness;
    (near.ln().abs() > STIFFNESS_REFUSED.ln()).then_some(StaticFailure::NotAsDeclared { ratio })
}

fn doubt_fit(known: &StaticParameters, servo: &StaticServo) -> Vec<String> {
    let resolution = known.resolution.max(known.setpoint_resolution);
    let most = (EXPLAINED_COUNTS * resolution).max(EXPLAINED * servo.gravity_span / servo.stiffness);
    if servo.residual <= most {
        return Vec::new();
    }
    vec![format!(
        "gravity, friction and backlash explain its offsets only within {:.4} rad (rms): URDF or posture may be wrong",
        servo.residual
    )]
}
