//! Keys that were renamed in version 0.2.0: an error about an old name gives the new one.

/// Old and new names of the keys of robot, task and suite files.
pub(crate) const RENAMED: &[(&str, &str)] = &[
    ("axes_in", "axes_frame"),
    ("bridged_cycles", "max_missed_cycles"),
    ("case", "variant"),
    ("damping_fades_over_rad_per_s", "damping_fade_velocity_rad_per_s"),
    ("gravity_by", "gravity_compensated_by"),
    ("longest_dropout_s", "max_dropout_s"),
    ("measures", "measured"),
    ("ratio", "servo_ticks_per_cycle"),
    ("refine", "adapt_gains"),
    ("scale", "true_over_nominal"),
    ("set", "override"),
    ("set_points", "setpoints"),
    ("slips_at_torque_limits", "holding_torque_ratio"),
    ("surroundings", "environment"),
    ("torque_share", "torque_fraction"),
    ("velocity_share", "velocity_fraction"),
    ("within", "max_relative_change"),
];

/// Returns the new name of the key that was called `old`, if `allowed` contains it.
pub(crate) fn present_name(old: &str, allowed: &[&str]) -> Option<&'static str> {
    RENAMED.iter().find(|(name, new)| *name == old && allowed.contains(new)).map(|(_, new)| *new)
}

#[cfg(test)]
mod tests {
    use super::RENAMED;
    use crate::files::robot::RobotFile;
    use crate::files::source::{Source, parse};
    use crate::files::task::TaskFile;

    /// Kind of file, old key, and a text with this key that contains only the tables required to reach it.
    const OLD_FILES: &[(&str, &str, &str)] = &[
        ("task", "axes_in", "[task.hand.cartesian]\naxes_in = \"world\"\n"),
        ("robot", "bridged_cycles", "[safety]\nbridged_cycles = 3\n"),
        (
            "robot",
            "damping_fades_over_rad_per_s",
            "[simulated.bristle]\ndamping_fades_over_rad_per_s = 1.0\n",
        ),
        ("robot", "gravity_by", "[interface]\ngravity_by = \"controller\"\n"),
        ("robot", "longest_dropout_s", "[safety]\nlongest_dropout_s = 0.1\n"),
        ("robot", "measures", "[interface]\nmeasures = [\"position\"]\n"),
        ("robot", "ratio", "[profile.fast]\nratio = 5\n"),
        ("robot", "refine", "[profile.fast]\nrefine = { time_s = 1.0 }\n"),
        ("robot", "scale", "[simulated]\nscale = { kp = 1.1 }\n"),
        ("robot", "set_points", "[interface]\nset_points = \"held\"\n"),
        ("robot", "slips_at_torque_limits", "[simulated.brake]\nslips_at_torque_limits = 1.0\n"),
        ("task", "surroundings", "[surroundings.wall]\n"),
        ("task", "torque_share", "[limits]\ntorque_share = 1.0\n"),
        ("task", "velocity_share", "[limits]\nvelocity_share = 1.0\n"),
        ("robot", "within", "[profile.fast.adapt_gains]\nwithin = 0.3\n"),
    ];

    /// Old keys of suite files, whose reader has the test of them.
    const OF_SUITES: [&str; 2] = ["case", "set"];

    #[test]
    fn old_key_error_names_new_key() {
        for &(old, new) in RENAMED.iter().filter(|(old, _)| !OF_SUITES.contains(old)) {
            let (kind, _, text) = OLD_FILES.iter().find(|(_, key, _)| *key == old).expect("an old file");
            let source = Source::new("old.toml", *text);
            let error = match *kind {
                "robot" => parse::<RobotFile>(&source).err(),
                _ => parse::<TaskFile>(&source).err(),
            };
            let error = error.expect("an old key").to_string();
            assert!(error.contains(&format!("unknown key `{old}`: it was renamed to `{new}`")), "{error}");
            assert!(error.starts_with("old.toml:"), "{error}");
        }
    }
}
