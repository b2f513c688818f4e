//! Margins and unavoidable errors of a transformer, in `opspace check`.

use opspace_experiment::{Experiment, Finding};
use opspace_preflight::{
    GearMargin, GearScale, JointFloor, JointImpedance, Margins, StableRange, TORQUE_HZ, alternatives, floors,
    impedances, margins,
};
use serde_json::{Value, json};
use std::fmt::Write as _;

/// Margins and unavoidable errors of a transformer.
pub struct Strength {
    /// With the transformer in use, and with its counterpart without or with current.
    margins: Vec<Margins>,
    /// With the transformers that were not chosen.
    alternatives: Vec<Margins>,
    /// Reason for the choice.
    reason: Option<String>,
    impedances: Vec<JointImpedance>,
    floors: Vec<JointFloor>,
}

impl Strength {
    /// Computes them for an experiment; `None` if commands pass without a transformer.
    pub fn of(experiment: &Experiment) -> Option<Self> {
        Some(Self {
            margins: margins(experiment),
            alternatives: alternatives(experiment),
            reason: experiment.transformer_reason(),
            impedances: impedances(experiment)?,
            floors: floors(experiment)?,
        })
    }

    pub fn diagnostics(&self, experiment: &Experiment) -> Vec<Finding> {
        let used = self.margins.first().and_then(|margins| margins.gears.as_ref());
        let gears = used.and_then(|gears| gears.finding(experiment));
        let active = JointImpedance::finding(&self.impedances, experiment);
        let simulated = self.margins.first().and_then(|margins| margins.finding(experiment));
        gears.into_iter().chain(active).chain(simulated).collect()
    }

    /// Line about what `-v` prints.
    pub fn hint() -> &'static str {
        "stable ranges of gains, filters, inertia, delay and gears, the other transformers, and torque errors by the encoders: `-v` prints them"
    }

    pub fn text(&self) -> String {
        let mut text = String::new();
        for margins in &self.margins {
            let _ = writeln!(text, "  {}", margins.to_string().replace('\n', "\n  "));
        }
        if let Some(reason) = self.reason.as_ref().filter(|_| !self.alternatives.is_empty()) {
            let _ = writeln!(text, "  chosen because {reason}; the other transformers:");
        }
        for margins in &self.alternatives {
            let _ = writeln!(text, "    {}", margins.transformer.as_str());
            for line in margins.in_short() {
                let _ = writeln!(text, "      {line}");
            }
        }
        let names = self.floors.iter().map(|floor| floor.joint.chars().count());
        let width = names.max().unwrap_or(0).clamp(5, 30);
        let _ = writeln!(
            text,
            "  real part of the impedance Z, and rms torque error by the encoders' resolution:"
        );
        let _ = writeln!(
            text,
            "    {:<width$}  {:>16}  {:>7}  {:>6}  {:>13}  {:>9}  {:>8}",
            "joint", "least Z, Nms/rad", "at, Hz", "of kv", "active, Hz", "error, Nm", "of limit"
        );
        for (impedance, floor) in self.impedances.iter().zip(&self.floors) {
            let active = impedance
                .active_hz
                .map_or_else(|| "-".to_owned(), |[from, to]| format!("{from:.0} to {to:.0}"));
            // A servo without damping has no kv.
            let of_kv = match impedance.kv_nms_per_rad {
                0.0 => "-".to_owned(),
                kv => format!("{:.0} %", 100.0 * impedance.least_nms_per_rad / kv),
            };
            let _ = writeln!(
                text,
                "    {:<width$}  {:>16.3}  {:>7.1}  {of_kv:>6}  {active:>13}  {:>9.4}  {:>6.2} %",
                impedance.joint,
                impedance.least_nms_per_rad,
                impedance.at_hz,
                floor.floor_nm,
                100.0 * floor.floor_nm / floor.torque_limit_nm,
            );
        }
        let rounded = self.floors.iter().filter(|floor| floor.setpoint_floor_nm > 0.0);
        for (number, floor) in rounded.enumerate() {
            if number == 0 {
                let _ = writeln!(text, "  rms torque error by the setpoints' resolution:");
                let _ = writeln!(text, "    {:<width$}  {:>9}  {:>8}", "joint", "error, Nm", "of limit");
            }
            let share = 100.0 * floor.setpoint_floor_nm / floor.torque_limit_nm;
            let _ = writeln!(
                text,
                "    {:<width$}  {:>9.4}  {share:>6.2} %",
                floor.joint, floor.setpoint_floor_nm
            );
        }
        let limited = self.floors.iter().filter_map(|floor| {
            let (amplitudes, hz) = (floor.within_setpoint_limits_nm?, floor.bandwidth_hz?);
            Some((&floor.joint, amplitudes, hz))
        });
        for (number, (joint, amplitudes, hz)) in limited.enumerate() {
            if number == 0 {
                let at = TORQUE_HZ.map(|hz| format!("{:>9}", format!("{hz} Hz"))).concat();
                let _ = writeln!(
                    text,
                    "  torque amplitudes within the limits of setpoints, joint held, Nm, and the bandwidth"
                );
                let _ = writeln!(text, "  of a tenth of the torque limit:");
                let _ = writeln!(text, "    {:<width$}{at}  bandwidth", "joint");
            }
            let amplitudes = amplitudes.map(|nm| format!("{nm:>9.1}")).concat();
            let _ = writeln!(text, "    {joint:<width$}{amplitudes}  {hz:>6.1} Hz");
        }
        text
    }

    pub fn json(&self) -> Value {
        let joint = |(impedance, floor): (&JointImpedance, &JointFloor)| {
            json!({
                "joint": floor.joint,
                "least_real_impedance_nms_per_rad": impedance.least_nms_per_rad,
                "least_real_impedance_hz": impedance.at_hz,
                "kv_nms_per_rad": impedance.kv_nms_per_rad,
                "viscous_nms_per_rad": impedance.viscous_nms_per_rad,
                "active_hz": impedance.active_hz,
                "encoder_floor_nm": floor.floor_nm,
                "setpoint_floor_nm": floor.setpoint_floor_nm,
                "torque_limit_nm": floor.torque_limit_nm,
                "within_setpoint_limits_nm": floor.within_setpoint_limits_nm,
                "bandwidth_within_setpoint_limits_hz": floor.bandwidth_hz,
            })
        };
        json!({
            "margins": self.margins.iter().map(margins_json).collect::<Vec<Value>>(),
            "alternatives": self.alternatives.iter().map(margins_json).collect::<Vec<Value>>(),
            "torque_hz": TORQUE_HZ,
            "joints": self.impedances.iter().zip(&self.floors).map(joint).collect::<Vec<Value>>(),
        })
    }
}

fn margins_json(margins: &Margins) -> Value {
    let range = |range: &StableRange| {
        let [least, most] = &range.ends;
        json!({
            "quantity": range.quantity.name(),
            "least": least.value,
            "least_joint": least.joint,
            "most": most.value,
            "most_joint": most.joint,
        })
    };
    json!({
        "transformer": margins.transformer,
        "unstable": margins.unstable,
        "ranges": margins.ranges.iter().map(range).collect::<Vec<Value>>(),
        "gears": margins.gears.as_ref().map(gears_json),
    })
}

fn gears_json(gears: &GearMargin) -> Value {
    let scale = match gears.scale {
        GearScale::AntiresonanceHz => "antiresonance_hz",
        GearScale::DeclaredStiffness => "times_declared_stiffness",
    };
    let oscillates = gears.oscillates.iter().map(|(value, joint)| json!({ "value": value, "joint": joint }));
    json!({ "scale": scale, "examined": gears.examined, "oscillates": oscillates.collect::<Vec<Value>>() })
}
