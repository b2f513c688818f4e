//! Remedies that diagnostics print: each is applied to a case for which it is printed, and helps. Compared: the findings of the case,
//! and those with the remedy. Keys, values and factors are taken from the printed text.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

mod case;
mod contact;
mod couplings;
mod limits;
mod models;
mod references;
mod runs;
mod stability;

use opspace_experiment::Code;
use opspace_experiment::codes::Effect;

/// Defines a test for each code, and the list of these codes.
macro_rules! cases {
    ($($code:ident $module:ident::$test:ident,)*) => {
        /// Codes whose remedies are applied.
        const CASES: &[Code] = &[$(Code::$code),*];

        $(
            #[test]
            fn $test() {
                $module::$test(Code::$code);
            }
        )*
    };
}

cases! {
    GoalOutOfReach references::goal_out_of_reach,
    JointTooFast references::joint_too_fast,
    AccelerationAboveLimit references::acceleration_above_limit,
    TorqueAboveLimit references::torque_above_limit,
    ReferenceJump references::reference_jump,
    MovesDuringRamp references::moves_during_ramp,
    ReferenceTooFast references::reference_too_fast,
    UnfinishedReference references::unfinished_reference,
    HalfTurn references::half_turn,
    LateEvent references::late_event,
    EarlyStatistics references::early_statistics,
    SingularStart references::singular_start,
    UncontrolledFreedom references::uncontrolled_freedom,
    CompliantDrift references::compliant_drift,
    FractionAboveOne limits::fraction_above_one,
    MarginAboveRange limits::margin_above_range,
    StartInMargin limits::start_in_margin,
    TargetBeyondLimits limits::target_beyond_limits,
    LimitOnTheWay limits::limit_on_the_way,
    WeightAboveLimit limits::weight_above_limit,
    WeightAboveRate limits::weight_above_rate,
    UnreachableSpeed limits::unreachable_speed,
    WeakJoint limits::weak_joint,
    StartInCollision contact::start_in_collision,
    ReferenceInCollision contact::reference_in_collision,
    StartInObject contact::start_in_object,
    ObjectOutOfReach contact::object_out_of_reach,
    PressesAway contact::presses_away,
    NothingAhead contact::nothing_ahead,
    ForceAboveLimit contact::force_above_limit,
    IgnoredCompliance contact::ignored_compliance,
    DampedCompliance contact::damped_compliance,
    ContactOscillation contact::contact_oscillation,
    ContactImpact contact::contact_impact,
    UnstableAdmittance contact::unstable_admittance,
    UnknownContact contact::unknown_contact,
    UnknownSensorLoad contact::unknown_sensor_load,
    GainsTooHigh stability::gains_too_high,
    SmallGainMargin stability::small_gain_margin,
    UnstableSimulation stability::unstable_simulation,
    OvercompensatedFriction stability::overcompensated_friction,
    GearOscillation stability::gear_oscillation,
    ActiveImpedance stability::active_impedance,
    FeedForwardImpulse stability::feed_forward_impulse,
    SlowSetpointFilter stability::slow_setpoint_filter,
    CoarseEncoder stability::coarse_encoder,
    CoarseSetpoints stability::coarse_setpoints,
    NarrowSetpointLimits stability::narrow_setpoint_limits,
    NoPassivityControl couplings::no_passivity_control,
    NeverTouched runs::never_touched,
    ContactLost runs::contact_lost,
    JointsHeld runs::joints_held,
    GoalNotReached runs::goal_not_reached,
    ReferenceLimited runs::reference_limited,
    EscapedSingularity runs::escaped_singularity,
    DampedDirection runs::damped_direction,
    CompliantAxesMoved runs::compliant_axes_moved,
    TorquesSaturated runs::torques_saturated,
    ImpossibleInertia models::impossible_inertia,
    FixedLinkInertia models::fixed_link_inertia,
    EqualLimits models::equal_limits,
    ZeroLimit models::zero_limit,
    NegativeLimit models::negative_limit,
    FarLimit models::far_limit,
    UndeclaredPrefix models::undeclared_prefix,
    IgnoredMimic models::ignored_mimic,
    FarCentre models::far_centre,
    SmallInertia models::small_inertia,
    LargeInertia models::large_inertia,
    UnequalMasses models::unequal_masses,
    NoLimit models::no_limit,
    WideRange models::wide_range,
}

/// Codes without a case, each with its reason.
const EXCEPTIONS: &[(Code, &str)] = &[
    (Code::UnknownGains, "the advice is a simulation, which changes nothing of what is known before the run"),
    (Code::CyclesMissed, "the advice is to find what delays the bus or the process"),
    (Code::ControlInterrupted, "the advice is to find what delays the bus or the process"),
    (Code::StaleTargets, "the advice concerns the sender of the targets"),
    (Code::SetpointsClamped, "the advice is to find what steps"),
    (
        Code::SetpointsLimited,
        "a simulated drive has the limits that are declared, and the loop keeps to them",
    ),
    (
        Code::SpringDeflected,
        "the advice is another stiffness or friction compensation, which changes by how much the spring is deflected",
    ),
    (
        Code::DriverDoubt,
        "the advice is to connect a device, to put a file in its place, or to change a gain of a real servo",
    ),
    (Code::NoShape, "`logs_do_not_need_meshes` has capsules of robot.toml in place of shapes"),
    (Code::MeshNotFound, "the advice is to supply the file of a mesh"),
    (Code::MeshFormat, "the advice is to convert the file of a mesh"),
];

#[test]
fn each_code_has_a_case_or_a_reason() {
    for code in Code::ALL {
        let advises = matches!(
            code.effect(),
            Effect::Reported | Effect::RefusedOnRealRobot | Effect::Noted | Effect::Failed
        );
        let places = CASES.iter().filter(|case| *case == code).count()
            + EXCEPTIONS.iter().filter(|(exception, _)| exception == code).count();
        assert_eq!(places, usize::from(advises), "{code}");
    }
    assert!(EXCEPTIONS.iter().all(|(_, reason)| reason.split(' ').count() > 3));
}
