//! Mechanical impedance of each joint's drive with the transformer, as the gear and the link feel it.
//!
//! The joint moves as a sine about its start position, the others rest, and the drive has its nominal parameters
//! ([`opspace_transformer::impedance`]). Where the real part of the impedance and the viscous friction of the joint add up
//! to less than zero, a resonance of gear, link or contact at that frequency may grow.

use super::changed;
use super::diagnostic::short;
use opspace_backend::Sample;
use opspace_backend::quantity::Positive;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_model::{Data, update};
use opspace_transformer::impedance::impedance_near;
use opspace_transformer::moving_joint::MovingJoint;
use opspace_transformer::{Gears, ServoLaw, VelocityEstimator};

/// Lowest examined frequency, Hz.
const LOWEST_HZ: f64 = 2.0;

/// Highest examined frequency, as a fraction of the interface rate: beyond it, sampling alone makes servos active.
const HIGHEST: f64 = 0.25;

/// Number of examined frequencies, evenly spaced on a logarithmic scale.
const FREQUENCIES: u32 = 13;

/// Negative damping beyond the viscous friction that is reported, as a fraction of kv (of that friction, if kv is zero): Coulomb friction and the damping of
/// gears absorb less.
const REPORTED: f64 = 0.1;

/// Factor of the rates that are proposed: delays and lags are half as long.
const FASTER: f64 = 2.0;

/// Real part of a joint's impedance.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct JointImpedance {
    /// Name of the joint.
    pub joint: String,
    /// Least real part, Nms/rad (Ns/m).
    pub least_nms_per_rad: f64,
    /// Frequency of the least real part, Hz.
    pub at_hz: f64,
    /// Damping kv of the servo, Nms/rad (Ns/m).
    pub kv_nms_per_rad: f64,
    /// Viscous friction of the joint, Nms/rad (Ns/m).
    pub viscous_nms_per_rad: f64,
    /// Lowest and highest examined frequency at which the real part and the viscous friction add up to less than zero,
    /// Hz.
    pub active_hz: Option<[f64; 2]>,
}

/// Computes the impedances of all joints at the start of a task; `None` if commands pass without a transformer.
#[must_use]
pub fn impedances(experiment: &Experiment) -> Option<Vec<JointImpedance>> {
    experiment.transformer_name()?;
    let model = &experiment.robot().model;
    let (n, profile) = (model.n(), experiment.profile().1);
    let mut data = Data::new(model);
    update(model, &mut data, &experiment.start().ok()?, &vec![0.0; n]).then_some(())?;
    let timing = experiment.drive_timing();
    let highest_hz = HIGHEST / timing.period_s();
    let step = (highest_hz / LOWEST_HZ).max(1.0).powf(1.0 / f64::from(FREQUENCIES - 1));
    let frequencies_hz: Vec<f64> =
        (0..FREQUENCIES).map(|i| LOWEST_HZ.min(highest_hz) * step.powi(i.cast_signed())).collect();
    let mut transformer = experiment.transformer().ok()?;
    let sample = Sample::new(&experiment.capabilities());
    let (servos, gains) = (experiment.servos().ok()?, experiment.servo_gains().ok()?);
    let joints = experiment.robot().joints();
    let mut found = Vec::new();
    for joint in 0..n {
        let law = ServoLaw::new(&servos[joint], timing.servo_period_s).ok()?;
        let viscous = joints[joint].friction.viscous_nms_per_rad.get();
        let mut least = (f64::INFINITY, 0.0);
        let mut active_hz: Option<[f64; 2]> = None;
        for &hz in &frequencies_hz {
            let velocity = VelocityEstimator::new(n, &profile.estimator, timing.period_s());
            let mut arm = MovingJoint::new(&mut *transformer, &data, joint, velocity, sample.clone());
            let (hz, z) = impedance_near(&mut arm, law, timing, hz);
            if z.re < least.0 {
                least = (z.re, hz);
            }
            if z.re + viscous < 0.0 {
                active_hz = Some([active_hz.map_or(hz, |[from, _]| from), hz]);
            }
        }
        found.push(JointImpedance {
            joint: model.joints()[joint].name.clone(),
            least_nms_per_rad: least.0,
            at_hz: least.1,
            kv_nms_per_rad: gains[joint].damping,
            viscous_nms_per_rad: viscous,
            active_hz,
        });
    }
    Some(found)
}

impl JointImpedance {
    /// Returns a diagnostic about the joint that is the most active for its friction, if any is, unless the gears are
    /// declared rigid.
    #[must_use]
    pub fn finding(impedances: &[Self], experiment: &Experiment) -> Option<Finding> {
        if experiment.robot().gears() == Gears::Rigid {
            return None;
        }
        let worst = most_active(impedances)?;
        let [from, to] = worst.active_hz?;
        let transformer = experiment.transformer_name()?;
        let message = format!(
            "joint '{}' is active between {from:.0} and {to:.0} Hz with transformer '{transformer}' (real part of the \
             impedance {} Nms/rad at {:.0} Hz, viscous friction {} Nms/rad): gear or contact resonances there may \
             grow",
            worst.joint,
            short(worst.least_nms_per_rad),
            worst.at_hz,
            short(worst.viscous_nms_per_rad),
        );
        let of_gears = "declare `gears = \"rigid\"` in [interface] if the gears are rigid";
        let helps = remedies(experiment);
        let help = if helps.is_empty() {
            format!(
                "no transformer, and no faster interface, makes the joint passive: use a drive whose setpoints act sooner; {of_gears}"
            )
        } else {
            format!("{}; {of_gears}", changed::alternatives(&helps))
        };
        let profile = experiment.profile().0;
        Some(
            Finding::new(Code::ActiveImpedance, &["profile", profile, "transformer"], message, help)
                .of_robot(),
        )
    }
}

/// Returns the joint that is the most active for its damping, if any is reported.
fn most_active(impedances: &[JointImpedance]) -> Option<&JointImpedance> {
    // A servo without damping is compared with the friction that damps its joint.
    let scale = |joint: &JointImpedance| match joint.kv_nms_per_rad {
        0.0 => joint.viscous_nms_per_rad,
        kv => kv,
    };
    let relative =
        |joint: &JointImpedance| (joint.least_nms_per_rad + joint.viscous_nms_per_rad) / scale(joint);
    let active = impedances.iter().filter(|joint| relative(joint) < -REPORTED);
    active.min_by(|a, b| relative(a).total_cmp(&relative(b)))
}

/// Remedies with which no joint is active.
fn remedies(experiment: &Experiment) -> Vec<String> {
    let helps = |changed: Option<Experiment>| {
        changed.and_then(|changed| impedances(&changed)).is_some_and(|found| most_active(&found).is_none())
    };
    let mut found = Vec::new();
    for name in changed::other_transformers(experiment) {
        if helps(changed::with_transformer(experiment, &name)) {
            found.push(format!("use '{name}'"));
            break;
        }
    }
    let (profile, parameters) = experiment.profile();
    let doubled = FASTER * parameters.servo_hz.get();
    let faster = changed::with_robot(experiment, |robot| {
        if let (Some(of_file), Ok(servo_hz)) =
            (robot.file.profile.get_mut(profile), Positive::try_from(doubled))
        {
            of_file.servo_hz = servo_hz;
        }
    });
    if helps(faster) {
        found.push(format!(
            "drives and an interface of twice the rate, `profile.{profile}.servo_hz = {doubled:?}`"
        ));
    }
    found
}
