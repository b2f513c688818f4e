//! Codes of diagnostics, refusals and warnings about models, and the page of each: `opspace explain CODE`.
//!
//! A code names a kind of problem and remains the same when its text changes. A mistake in a file, an unknown key for example,
//! has none: its message says all. The pages are in `codes.md`, one section for each code.

use crate::suggest::nearest;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// Pages of all codes.
const PAGES: &str = include_str!("codes.md");

/// Place of what exists only for comparisons, as the end of a sentence.
pub const COMPARISONS: &str = "are in another program: `cargo run --release -p opspace-testing --example opspace-comparisons --` in place of `opspace`";

/// Effect of a problem on a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Effect {
    /// It is reported before a run; nothing is refused.
    Reported,
    /// It is noted after a run.
    Noted,
    /// It is reported after a run, which has failed.
    Failed,
    /// A run is refused, unless the code is allowed.
    Refused,
    /// A run on a real robot is refused, unless the code is allowed; in simulation it is reported.
    RefusedOnRealRobot,
    /// A run is always refused, for this reason.
    Never(&'static str),
}

macro_rules! codes {
    ($($kind:ident $name:literal $effect:expr,)*) => {
        /// Kind of a problem that is predicted, refused, or found in a model.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Code {
            $(
                #[doc = concat!("`", $name, "`: see its page.")]
                $kind,
            )*
            /// Code of a check that a program has added.
            Added(&'static str),
        }

        impl Code {
            /// All codes, in the order of their pages.
            pub const ALL: &[Self] = &[$(Self::$kind),*];

            /// Name of the code.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                    Self::Added(name) => name,
                }
            }

            /// Effect of the problem on a run.
            #[must_use]
            pub fn effect(self) -> Effect {
                match self {
                    $(Self::$kind => $effect,)*
                    Self::Added(_) => Effect::Reported,
                }
            }
        }
    };
}

/// Reason why a model with impossible inertias is never simulated.
const FALSE_DYNAMICS: &str = "it falsifies masses and torques, and so every result";

codes! {
    // References.
    GoalOutOfReach "goal-out-of-reach" Effect::Reported,
    JointTooFast "joint-too-fast" Effect::Reported,
    AccelerationAboveLimit "acceleration-above-limit" Effect::Reported,
    TorqueAboveLimit "torque-above-limit" Effect::Reported,
    ReferenceJump "reference-jump" Effect::Reported,
    MovesDuringRamp "moves-during-ramp" Effect::Reported,
    ReferenceTooFast "reference-too-fast" Effect::Reported,
    UnfinishedReference "unfinished-reference" Effect::Reported,
    HalfTurn "half-turn" Effect::Reported,
    LateEvent "late-event" Effect::Reported,
    EarlyStatistics "early-statistics" Effect::Reported,
    // Freedom.
    SingularStart "singular-start" Effect::Reported,
    UncontrolledFreedom "uncontrolled-freedom" Effect::Reported,
    CompliantDrift "compliant-drift" Effect::Reported,
    // Limits.
    FractionAboveOne "fraction-above-one" Effect::Reported,
    MarginAboveRange "margin-above-range" Effect::Reported,
    StartInMargin "start-in-margin" Effect::Reported,
    TargetBeyondLimits "target-beyond-limits" Effect::Reported,
    LimitOnTheWay "limit-on-the-way" Effect::Reported,
    WeightAboveLimit "weight-above-limit" Effect::Reported,
    WeightAboveRate "weight-above-rate" Effect::Reported,
    UnreachableSpeed "unreachable-speed" Effect::Reported,
    WeakJoint "weak-joint" Effect::Reported,
    // Collisions and contact.
    StartInCollision "start-in-collision" Effect::Reported,
    ReferenceInCollision "reference-in-collision" Effect::Reported,
    StartInObject "start-in-object" Effect::Reported,
    ObjectOutOfReach "object-out-of-reach" Effect::Reported,
    PressesAway "presses-away" Effect::Reported,
    NothingAhead "nothing-ahead" Effect::Reported,
    ForceAboveLimit "force-above-limit" Effect::Reported,
    IgnoredCompliance "ignored-compliance" Effect::Reported,
    DampedCompliance "damped-compliance" Effect::Reported,
    ContactOscillation "contact-oscillation" Effect::Reported,
    ContactImpact "contact-impact" Effect::Reported,
    UnstableAdmittance "unstable-admittance" Effect::Reported,
    UnknownContact "unknown-contact" Effect::Reported,
    UnknownSensorLoad "unknown-sensor-load" Effect::Reported,
    // Stability.
    GainsTooHigh "gains-too-high" Effect::RefusedOnRealRobot,
    UnknownGains "unknown-gains" Effect::Reported,
    SmallGainMargin "small-gain-margin" Effect::RefusedOnRealRobot,
    UnstableSimulation "unstable-simulation" Effect::Reported,
    OvercompensatedFriction "overcompensated-friction" Effect::Reported,
    GearOscillation "gear-oscillation" Effect::RefusedOnRealRobot,
    FeedForwardImpulse "feed-forward-impulse" Effect::RefusedOnRealRobot,
    NarrowSetpointLimits "narrow-setpoint-limits" Effect::Reported,
    SlowSetpointFilter "slow-setpoint-filter" Effect::Reported,
    CoarseEncoder "coarse-encoder" Effect::Reported,
    CoarseSetpoints "coarse-setpoints" Effect::Reported,
    ActiveImpedance "active-impedance" Effect::Reported,
    // Couplings.
    NoPassivityControl "no-passivity-control" Effect::Reported,
    LatePackets "late-packets" Effect::Refused,
    ActiveWaves "active-waves" Effect::Refused,
    // Found in the log of a run.
    NeverTouched "never-touched" Effect::Failed,
    ContactLost "contact-lost" Effect::Failed,
    CyclesMissed "cycles-missed" Effect::Failed,
    JointsHeld "joints-held" Effect::Failed,
    ControlInterrupted "control-interrupted" Effect::Noted,
    StaleTargets "stale-targets" Effect::Noted,
    SetpointsClamped "setpoints-clamped" Effect::Noted,
    SetpointsLimited "setpoints-limited" Effect::Noted,
    GoalNotReached "goal-not-reached" Effect::Noted,
    ReferenceLimited "reference-limited" Effect::Noted,
    EscapedSingularity "escaped-singularity" Effect::Noted,
    DampedDirection "damped-direction" Effect::Noted,
    CompliantAxesMoved "compliant-axes-moved" Effect::Noted,
    TorquesSaturated "torques-saturated" Effect::Noted,
    SpringDeflected "spring-deflected" Effect::Noted,
    // Robots.
    FrictionObserverWithoutSensor "friction-observer-without-sensor" Effect::Refused,
    ComparisonOnly "comparison-only" Effect::Never("it exists for comparisons in simulation and can damage a real robot"),
    AwayFromStart "away-from-start" Effect::Never("the first setpoint would jump"),
    MissingDriver "missing-driver" Effect::Never("without a driver there is nothing to run on"),
    DriverDoubt "driver-doubt" Effect::Reported,
    NotSimulated "not-simulated" Effect::Never("without [simulated] there is nothing to simulate"),
    MissingValues "missing-values" Effect::Never("opspace guesses no value that results rest on"),
    // Models.
    NegativeInertia "negative-inertia" Effect::Never(FALSE_DYNAMICS),
    MasslessLink "massless-link" Effect::Never(FALSE_DYNAMICS),
    ImpossibleInertia "impossible-inertia" Effect::Reported,
    FixedLinkInertia "fixed-link-inertia" Effect::Reported,
    EqualLimits "equal-limits" Effect::Reported,
    ZeroLimit "zero-limit" Effect::Reported,
    NegativeLimit "negative-limit" Effect::Reported,
    FarLimit "far-limit" Effect::Reported,
    UndeclaredPrefix "undeclared-prefix" Effect::Reported,
    IgnoredMimic "ignored-mimic" Effect::Reported,
    FarCentre "far-centre" Effect::Reported,
    SmallInertia "small-inertia" Effect::Reported,
    LargeInertia "large-inertia" Effect::Reported,
    UnequalMasses "unequal-masses" Effect::Reported,
    NoLimit "no-limit" Effect::Reported,
    WideRange "wide-range" Effect::Reported,
    NoShape "no-shape" Effect::Reported,
    MeshNotFound "mesh-not-found" Effect::Reported,
    MeshFormat "mesh-format" Effect::Reported,
}

impl Code {
    /// Page of the code: what it means, why it matters, what to do, and an example.
    #[must_use]
    pub fn page(self) -> &'static str {
        let mut sections = PAGES.split("\n## ").skip(1);
        let own = sections.find_map(|section| section.strip_prefix(self.name())?.strip_prefix('\n'));
        own.unwrap_or_default().trim()
    }

    /// First sentence of the page.
    #[must_use]
    pub fn summary(self) -> &'static str {
        let first = self.page().split("\n\n").next().unwrap_or_default();
        first.split_once(". ").map_or(first, |(sentence, _)| sentence).trim_end_matches('.')
    }

    /// Names of the pages, in their order.
    #[must_use]
    pub fn pages() -> Vec<&'static str> {
        PAGES.split("\n## ").skip(1).filter_map(|section| section.lines().next()).collect()
    }
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Code {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

impl fmt::Display for Code {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Code {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|code| code.name() == name);
        found.copied().ok_or_else(|| {
            let near = nearest(name, Self::ALL.iter().map(|code| code.name()));
            let near = near.map_or_else(String::new, |near| format!(": did you mean '{near}'?"));
            format!("there is no code '{name}'{near}; `opspace explain` lists all codes")
        })
    }
}

/// Reads a code that a user allows.
///
/// # Errors
/// An unknown code, or one that cannot be allowed.
pub fn allowed_code(name: &str) -> Result<Code, String> {
    let code: Code = name.parse()?;
    match code.effect() {
        Effect::Refused | Effect::RefusedOnRealRobot => Ok(code),
        Effect::Reported | Effect::Noted | Effect::Failed => {
            Err(format!("'{code}' is only reported: it refuses no run"))
        }
        Effect::Never(reason) => Err(format!("'{code}' cannot be allowed: {reason}")),
    }
}

/// Refusal that the user has allowed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AllowedRefusal {
    /// Name of the code.
    pub code: String,
    /// Description of the problem.
    pub message: String,
}

impl fmt::Display for AllowedRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} [{}, allowed]", self.message, self.code)
    }
}
