//! Page about an identification: Bode plots of T and D* for each joint, and friction over speed; for a joint that was identified
//! statically, its offsets over the torque of gravity.

use super::{IdentificationResults, JointIdentification};
use nalgebra::Complex;
use opspace_identify::interval::SetpointFilterModel;
use opspace_identify::static_identification::StaticServo;
use opspace_identify::static_identification::sweep::StaticPoint;
use opspace_identify::{Interval95, TorqueScale};
use opspace_report::figure::{Figure, Panel, Scale, Series, Style};
use opspace_report::html::Page;

/// Span of the torque of gravity of a joint on which it has no effect, Nm (N): rounding.
const NO_GRAVITY_NM: f64 = 1e-6;

/// Number of points of a drawn curve.
const CURVE: usize = 300;

/// Notes below the table of the joints that were identified with multisines.
const NOTES: [&str; 2] = [
    "Doubtful: a warning above says what the measurement does not confirm. \
     Torque mode is refused for a joint whose servo cannot be inverted, and if the scale of torque is unknown: \
     all torques are then relative to the inertia.",
    "T: closed loop from setpoint (commanded position) to position. T error: relative error of the modelled T at \
     the largest amplitude, rms over coherent frequencies, up to the given bandwidth. Torque error: relative \
     error of the motor torque computed from setpoints and measured positions. Distortion: rms motion at \
     frequencies that are not excited, relative to that at the excited ones.",
];

/// Notes below the table of the joints that were identified statically.
const STATIC_NOTES: [&str; 2] = [
    "Stiffness: torque per offset of the setpoint from the position, with the masses of the URDF. With weight: the same from the \
     difference that the hung weight makes, without these masses. Gravity: span of the torque of gravity over the motion; it has to be four \
     times Coulomb friction.",
    "Doubtful: a warning above says what the measurement does not confirm. Torque mode is refused for a joint whose stiffness is not \
     identified, or is not the declared one.",
];

/// Draws the page about an identification.
#[must_use]
pub fn identification_page(results: &IdentificationResults) -> String {
    let title = format!("Servos of {}, profile {}", results.robot.name(), results.profile_name);
    let has = |is_static: bool| results.joints.iter().any(|joint| joint.is_static() == is_static);
    let multisines = "Each joint was excited about its initial position by odd random-phase multisines at two amplitudes, \
                      while the other joints were held.";
    let sweeps = "Each joint with a servo without a velocity loop moved slowly through its range in both directions, while the others \
                  were held: offsets between setpoint and position under a known weight show the stiffness of its servo, and their \
                  difference between the directions shows friction.";
    let lead = [(false, multisines), (true, sweeps)]
        .into_iter()
        .filter(|(is_static, _)| has(*is_static))
        .map(|(_, text)| text)
        .chain(["Points are measured; curves are the identified models."])
        .collect::<Vec<_>>()
        .join(" ");
    let mut page = Page::new(title).lead(&lead);
    for joint in &results.joints {
        if let Some(reason) = &joint.no_torque_mode {
            page = page.warning(&format!("{}: torque control refused. {reason}.", joint.name));
        }
        for doubt in &joint.found.doubts {
            page = page.warning(&format!("{}: {doubt}.", joint.name));
        }
    }
    page = page.section("Results");
    for (is_static, table) in results.tables() {
        let notes: &[&str] = if is_static { &STATIC_NOTES } else { &NOTES };
        page = page.table("Identified parameters of each joint", &table, notes);
    }
    for joint in &results.joints {
        page = with_joint(page.section(&joint.name), joint);
    }
    page.render()
}

fn with_joint(mut page: Page, joint: &JointIdentification) -> Page {
    if let Some(servo) = &joint.found.static_servo {
        // Without gravity there is no line.
        if servo.gravity_span > NO_GRAVITY_NM {
            page = page.figure(&offsets(joint, servo));
        }
        return page.facts(static_facts(joint, servo));
    }
    if !joint.found.measured.is_empty() {
        page = page.figure(&position(joint)).figure(&effective(joint));
    }
    if let Some(figure) = friction(joint) {
        page = page.figure(&figure);
    }
    page.facts(facts(joint))
}

/// Offsets over the torque of gravity in both directions, without the part of viscous friction, with the fitted lines.
fn offsets(joint: &JointIdentification, servo: &StaticServo) -> Figure {
    let viscous = servo.viscous + joint.static_damping();
    let load = |point: &StaticPoint| point.gravity + point.weight;
    let measured = |label: &str, direction: f64| {
        let points = servo.points.iter().filter(|point| point.speed * direction > 0.0);
        let (x, y) = points.map(|p| (load(p), p.offset - p.speed * viscous / servo.stiffness)).unzip();
        Series::new(label, x, y).style(Style::Dots)
    };
    let ends = servo
        .points
        .iter()
        .map(load)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], g| [least.min(g), most.max(g)]);
    let fitted = |label: &str, direction: f64| {
        let y = ends.map(|g| (g + direction * servo.coulomb) / servo.stiffness);
        Series::new(label, ends.to_vec(), y.to_vec()).style(Style::Desired)
    };
    Figure {
        title: format!("Offset of setpoint from position over the torque of gravity of {}", joint.name),
        caption: "Means near each posture at all speeds, without the part of viscous friction. The slope of the lines is one over the \
                  stiffness; their distance is twice Coulomb friction over the stiffness."
            .to_owned(),
        panels: vec![Panel {
            x_label: "torque of gravity (N·m)".to_owned(),
            y_label: "offset (rad)".to_owned(),
            series: vec![
                measured("upwards", 1.0),
                measured("downwards", -1.0),
                fitted("fitted, upwards", 1.0),
                fitted("fitted, downwards", -1.0),
            ],
            ..Panel::default()
        }],
        ..Figure::default()
    }
}

fn static_facts(joint: &JointIdentification, servo: &StaticServo) -> Vec<(&'static str, String)> {
    let within = |interval: Interval95| format!("{:.4} to {:.4}", interval.lower, interval.upper);
    let mut facts = vec![
        ("95 % interval of the stiffness (Nm/rad)", within(servo.stiffness_interval)),
        ("95 % interval of Coulomb friction (Nm)", within(servo.coulomb_interval)),
        ("95 % interval of viscous friction (Nms/rad)", within(servo.viscous_interval)),
        ("rms error of the offsets (mrad)", format!("{:.2}", 1e3 * servo.residual)),
    ];
    if let Some(sweep) = &joint.sweep {
        let posture: Vec<String> = sweep.posture.iter().map(|q| format!("{q:.2}")).collect();
        facts.push((
            "motion",
            format!(
                "from {:.2} to {:.2} rad, from the posture {}",
                sweep.lower,
                sweep.upper,
                posture.join(", ")
            ),
        ));
    }
    if let Some(hung) = servo.hung_weight {
        facts.push((
            "with the hung weight: stiffness (Nm/rad), masses over those of the URDF, with 95 % intervals",
            format!(
                "{:.3} ({}); {:.3} ({})",
                hung.stiffness,
                within(hung.stiffness_interval),
                hung.mass_scale,
                within(hung.mass_scale_interval)
            ),
        ));
    }
    facts
}

fn facts(joint: &JointIdentification) -> Vec<(&'static str, String)> {
    let mut facts = vec![("initial position", format!("{:.3} rad (m)", joint.position_rad))];
    for measured in &joint.found.measured {
        let d = &measured.distortion;
        facts.push((
            "amplitude (rms), and response at even lines, at other odd lines, and noise",
            format!("{:.2e} rad: {:.1e}, {:.1e}, {:.1e}", measured.rms, d.even, d.odd, d.noise),
        ));
    }
    if let Some([free, held]) = joint.urdf_inertia_kg_m2 {
        facts.push((
            "inertia from URDF and rotor, other joints free and held",
            format!("{free:.4} and {held:.4} kg m²"),
        ));
    }
    facts.extend(servo_facts(joint));
    if let Some(trust) = &joint.found.fit_quality {
        let [kp, kv] = trust.deviation;
        facts.push((
            "standard deviation of kp and kv",
            format!("{:.2} % and {:.2} %", 100.0 * kp, 100.0 * kv),
        ));
        facts.push(("fit error of the next best delay", format!("{:.1} times as large", trust.delay_margin)));
        if let Some(ratio) = trust.inertia_over_urdf {
            facts.push(("inertia relative to URDF and rotor", format!("{ratio:.3}")));
        }
    }
    if let Some(fitted) = &joint.found.rational {
        let list = |c: &[f64]| c.iter().map(|v| format!("{v:.4e}")).collect::<Vec<_>>().join(", ");
        facts.push((
            "rational T without hold and delay: coefficients from s⁰ on",
            format!(
                "({}) / ({}); error {:.1} %",
                list(&fitted.rational.numerator),
                list(&fitted.rational.denominator),
                100.0 * joint.found.rational_residual.unwrap_or(f64::NAN)
            ),
        ));
    }
    facts
}
/// 95 % intervals of the estimates, and what the responses show of setpoint path and gear.
fn servo_facts(joint: &JointIdentification) -> Vec<(&'static str, String)> {
    let Some(servo) = &joint.found.servo else { return Vec::new() };
    let all = &servo.intervals;
    let mut facts: Vec<(&'static str, String)> = [
        ("95 % interval of kp (1/s)", all.kp),
        ("95 % interval of kv (Nms/rad)", all.kv),
        ("95 % interval of the velocity filter (Hz)", all.velocity_filter_hz),
        ("95 % interval of the delay (servo ticks)", all.delay),
        ("95 % interval of the inertia (kg m²)", all.inertia),
        ("95 % interval of Coulomb friction (Nm)", all.coulomb),
        ("95 % interval of viscous friction (Nms/rad)", all.viscous),
    ]
    .map(|(name, interval)| {
        let withheld = || "not determined by this measurement".to_owned();
        (name, interval.map_or_else(withheld, |i| format!("{:.4} to {:.4}", i.lower, i.upper)))
    })
    .into();
    facts.push(("path of the setpoint", setpoint_path(joint)));
    if let Some(gear) = &servo.gear {
        facts.push((
            "elastic gear: antiresonance and resonance, stiffness with 95 % interval",
            format!(
                "{:.1} and {:.1} Hz, {:.0} ({:.0} to {:.0}) Nm/rad",
                gear.antiresonance_hz,
                gear.resonance_hz,
                gear.stiffness,
                gear.stiffness_interval.lower,
                gear.stiffness_interval.upper
            ),
        ));
    }
    facts
}

/// Feed-forward and filter of the setpoint that the responses show.
fn setpoint_path(joint: &JointIdentification) -> String {
    let Some(servo) = &joint.found.servo else { return String::new() };
    let filter = match servo.setpoint_filter {
        SetpointFilterModel::FirstOrder { cutoff_hz } => format!("filter of first order, {cutoff_hz:.1} Hz"),
        SetpointFilterModel::SecondOrder { natural_frequency_hz, damping_ratio } => {
            format!("filter of second order, {natural_frequency_hz:.1} Hz, damping ratio {damping_ratio:.2}")
        }
        SetpointFilterModel::None => String::new(),
    };
    let forward = match servo.velocity_feed_forward {
        0.0 => String::new(),
        share => format!("{:.0} % of its velocity fed forward", 100.0 * share),
    };
    match (filter.is_empty(), forward.is_empty()) {
        (true, true) => "direct".to_owned(),
        (false, false) => format!("{filter}; {forward}"),
        _ => filter + &forward,
    }
}

/// Bode plot of T, measured and modelled.
fn position(joint: &JointIdentification) -> Figure {
    let mut curves = measured(joint, |_, t| Some(t));
    let hz = frequencies(joint);
    if let Some(fitted) = &joint.found.rational {
        curves.push(curve("rational", Style::Thin, &hz, |hz| Some(fitted.at(hz))));
    }
    curves.push(curve("servo", Style::Desired, &hz, |hz| joint.found.model(&joint.known, hz)));
    Figure {
        title: format!("T of {}: position over setpoint", joint.name),
        caption: "Measured at two amplitudes; the rational model; the identified servo at its servo rate, with the friction \
                  of the largest amplitude."
            .to_owned(),
        panels: bode(curves, "|T| (1)"),
        columns: Some(2),
        ..Figure::default()
    }
}

/// Bode plot of D*, computed from measured and modelled T.
fn effective(joint: &JointIdentification) -> Figure {
    let found = &joint.found;
    let mut curves = measured(joint, |hz, t| found.effective_servo(hz, t));
    let hz = frequencies(joint);
    if let Some(rational) = &found.rational {
        curves.push(curve("rational", Style::Thin, &hz, |hz| found.effective_servo(hz, rational.at(hz))));
    }
    curves.push(curve("servo", Style::Desired, &hz, |hz| {
        found.effective_servo(hz, found.model(&joint.known, hz)?)
    }));
    let unit = match found.scale {
        TorqueScale::Unknown => "|D*| over inertia (1/s²)",
        _ => "|D*| (N·m/rad)",
    };
    Figure {
        title: format!("D* of {}: the effective servo of equation (K6)", joint.name),
        caption: "T/(G* (1 − T)), with G* of the identified inertia and viscous friction. At low frequencies, where Coulomb \
                  friction dominates the torque, it depends on the amplitude."
            .to_owned(),
        panels: bode(curves, unit),
        columns: Some(2),
        ..Figure::default()
    }
}

/// Label, style, and values over frequency (Hz).
type Curve = (String, Style, Vec<(f64, Option<Complex<f64>>)>);

/// Curves of a quantity computed from the measured T, one per amplitude.
fn measured(
    joint: &JointIdentification,
    of: impl Fn(f64, Complex<f64>) -> Option<Complex<f64>>,
) -> Vec<Curve> {
    (joint.found.measured.iter())
        .map(|m| {
            let points = m.position.iter().map(|p| (p.hz, of(p.hz, p.value))).collect();
            (format!("measured, {:.1e} rad rms", m.rms), Style::Dots, points)
        })
        .collect()
}

fn curve(label: &str, style: Style, hz: &[f64], of: impl Fn(f64) -> Option<Complex<f64>>) -> Curve {
    (label.to_owned(), style, hz.iter().map(|&hz| (hz, of(hz))).collect())
}

/// Frequencies of a drawn curve, Hz: logarithmically spaced over the excited range.
fn frequencies(joint: &JointIdentification) -> Vec<f64> {
    let points = joint.found.measured.first().map_or(&[][..], |m| &m.position);
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let ratio = last.hz / first.hz;
    (0..CURVE).map(|k| first.hz * ratio.powf(k as f64 / (CURVE - 1) as f64)).collect()
}

/// Panels of magnitude and phase.
fn bode(curves: Vec<Curve>, magnitude: &str) -> Vec<Panel> {
    let panel = |title: &str, y_label: &str, y_scale: Scale, of: fn(Complex<f64>) -> f64| Panel {
        title: title.to_owned(),
        x_label: "frequency (Hz)".to_owned(),
        y_label: y_label.to_owned(),
        series: (curves.iter())
            .map(|(label, style, points)| {
                let x = points.iter().map(|(hz, _)| *hz).collect();
                let y = points.iter().map(|(_, v)| v.map_or(f64::NAN, of)).collect();
                let y = if y_scale == Scale::Linear { unwrapped(y) } else { y };
                Series::new(label.as_str(), x, y).style(*style)
            })
            .collect(),
        x_scale: Scale::Log,
        y_scale,
        ..Panel::default()
    };
    vec![
        panel("magnitude", magnitude, Scale::Log, |v| v.norm()),
        panel("phase", "phase (°)", Scale::Linear, |v| v.arg().to_degrees()),
    ]
}

/// Unwraps phases: removes jumps of 360°. All phases in degrees.
fn unwrapped(mut degrees: Vec<f64>) -> Vec<f64> {
    for k in 1..degrees.len() {
        let turns = ((degrees[k] - degrees[k - 1]) / 360.0).round();
        if turns.is_finite() {
            degrees[k] -= 360.0 * turns;
        }
    }
    degrees
}

fn friction(joint: &JointIdentification) -> Option<Figure> {
    let servo = joint.found.servo.as_ref()?;
    let curve = servo.friction?;
    let fastest = servo.passes.iter().map(|p| p.speed).fold(0.0, f64::max);
    let speeds: Vec<f64> = (1..=CURVE).map(|k| fastest * k as f64 / CURVE as f64).collect();
    let torques = speeds.iter().map(|&v| curve.at(v)).collect();
    let (x, y) = servo.passes.iter().map(|p| (p.speed, p.torque)).unzip();
    Some(Figure {
        title: format!("Friction of {}", joint.name),
        caption: "Half the difference of the torques in both directions at constant speed.".to_owned(),
        panels: vec![Panel {
            x_label: "speed (rad/s)".to_owned(),
            y_label: match joint.found.scale {
                TorqueScale::Unknown => "friction over inertia (rad/s²)".to_owned(),
                _ => "friction (N·m)".to_owned(),
            },
            series: vec![
                Series::new("measured", x, y).style(Style::Dots),
                Series::new("fitted", speeds, torques).style(Style::Desired),
            ],
            ..Panel::default()
        }],
        ..Figure::default()
    })
}
