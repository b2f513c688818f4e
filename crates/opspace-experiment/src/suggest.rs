//! Similar names, lists of names, and the units at the end of keys.

/// Returns the candidate that is most similar to a name, if any is similar enough.
///
/// Similar enough means a Jaro-Winkler similarity of at least 0.9, or a Damerau-Levenshtein distance of at most a
/// third of the length of the name and a similarity above 0.5. Case is ignored, and `-` equals `_`.
pub fn nearest<'a, S, I>(name: &str, candidates: I) -> Option<&'a str>
where
    S: AsRef<str> + ?Sized + 'a,
    I: IntoIterator<Item = &'a S>,
{
    let fold = |text: &str| text.to_lowercase().replace('-', "_");
    let name = fold(name);
    let limit = (name.chars().count() / 3).max(1);
    let scored = candidates.into_iter().map(AsRef::as_ref).filter_map(|candidate| {
        let other = fold(candidate);
        let distance = strsim::damerau_levenshtein(&name, &other);
        let similarity = strsim::jaro_winkler(&name, &other);
        // Short names such as `x` and `y` are one edit apart without a common letter: they are not similar.
        let near = distance == 0 || similarity >= 0.9 || (distance <= limit && similarity > 0.5);
        near.then_some((candidate, distance, similarity))
    });
    let best = scored.min_by(|a, b| a.1.cmp(&b.1).then(b.2.total_cmp(&a.2)));
    best.map(|(candidate, ..)| candidate)
}

/// Returns a hint with the most similar of the known names and a list of all of them.
pub fn choices<'a, S: AsRef<str> + ?Sized + 'a>(
    name: &str,
    known: impl IntoIterator<Item = &'a S>,
) -> String {
    let all: Vec<&str> = known.into_iter().map(AsRef::as_ref).collect();
    let listed = list(all.iter().copied());
    match nearest(name, all) {
        Some(near) => format!("did you mean '{near}'? There are: {listed}"),
        None => format!("there are: {listed}"),
    }
}

/// Joins the names with commas.
pub fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<&str> = names.collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

pub(crate) struct Unit {
    pub(crate) suffix: &'static str,
    pub(crate) symbol: &'static str,
    /// Physical quantity; the ratio of the `si` of two units of the same quantity is their conversion factor.
    pub(crate) quantity: &'static str,
    pub(crate) si: f64,
}

const fn unit(suffix: &'static str, symbol: &'static str, quantity: &'static str, si: f64) -> Unit {
    Unit { suffix, symbol, quantity, si }
}

/// Units by the suffix of key names. A suffix that is the end of a longer one comes after it.
const UNITS: &[Unit] = {
    use std::f64::consts::{PI, TAU};
    &[
        unit("nms_per_rad", "N·m·s/rad", "rotational damping", 1.0),
        unit("nm_per_rad", "N·m/rad", "rotational stiffness", 1.0),
        unit("nm_per_deg", "N·m/°", "rotational stiffness", 180.0 / PI),
        unit("nm_per_a", "N·m/A", "torque constant", 1.0),
        unit("n_per_mm", "N/mm", "stiffness", 1e3),
        unit("n_per_m", "N/m", "stiffness", 1.0),
        unit("ns_per_m", "N·s/m", "damping", 1.0),
        unit("rad_per_s2", "rad/s²", "angular acceleration", 1.0),
        unit("deg_per_s2", "°/s²", "angular acceleration", PI / 180.0),
        unit("mm_per_s", "mm/s", "speed", 1e-3),
        unit("m_per_s2", "m/s²", "acceleration", 1.0),
        unit("m_per_s", "m/s", "speed", 1.0),
        unit("rad_per_s", "rad/s", "frequency", 1.0),
        unit("deg_per_s", "°/s", "frequency", PI / 180.0),
        unit("per_s", "1/s", "rate", 1.0),
        unit("kg_m2", "kg·m²", "inertia", 1.0),
        unit("rpm", "rpm", "frequency", TAU / 60.0),
        unit("khz", "kHz", "frequency", TAU * 1e3),
        unit("hz", "Hz", "frequency", TAU),
        unit("rad", "rad", "angle", 1.0),
        unit("deg", "°", "angle", PI / 180.0),
        unit("nmm", "N·mm", "torque", 1e-3),
        unit("nm", "N·m", "torque", 1.0),
        unit("kn", "kN", "force", 1e3),
        unit("kg", "kg", "mass", 1.0),
        unit("ms", "ms", "time", 1e-3),
        unit("us", "µs", "time", 1e-6),
        unit("mm", "mm", "length", 1e-3),
        unit("cm", "cm", "length", 1e-2),
        unit("n", "N", "force", 1.0),
        unit("g", "g", "mass", 1e-3),
        unit("s", "s", "time", 1.0),
        unit("m", "m", "length", 1.0),
        unit("a", "A", "current", 1.0),
        unit("v", "V", "voltage", 1.0),
        unit("w", "W", "power", 1.0),
    ]
};

pub(crate) fn unit_of(key: &str) -> Option<&'static Unit> {
    UNITS.iter().find(|unit| key.strip_suffix(unit.suffix).is_some_and(|stem| stem.ends_with('_')))
}

/// Symbol of the unit at the end of a key's name: `stiffness_n_per_m` is in `N/m`.
#[must_use]
pub fn unit_symbol(key: &str) -> Option<&'static str> {
    unit_of(key).map(|unit| unit.symbol)
}

pub(crate) fn stem(key: &str) -> &str {
    unit_of(key).map_or(key, |unit| &key[..key.len() - unit.suffix.len() - 1])
}

/// Returns the allowed key for the same quantity with another unit, or with the unit that `name` omits.
pub(crate) fn same_but_unit<'a>(name: &str, allowed: &[&'a str]) -> Option<&'a str> {
    allowed.iter().copied().find(|candidate| *candidate != name && stem(candidate) == stem(name))
}

/// Hint about the different units of two keys; `None` if the units are equal.
pub(crate) fn units_differ(name: &str, meant: &str) -> Option<String> {
    let to = unit_of(meant)?;
    match unit_of(name) {
        None if stem(meant) == name => Some(format!("The unit, {}, is part of the name.", to.symbol)),
        Some(from) if from.suffix == to.suffix => None,
        Some(from) if from.quantity == to.quantity => {
            let factor = format!("{:.5e}", from.si / to.si).parse::<f64>().unwrap_or(f64::NAN);
            Some(format!("The units differ: 1 {} is {factor} {}.", from.symbol, to.symbol))
        }
        Some(from) => Some(format!("The units differ: {} is not {}.", from.symbol, to.symbol)),
        None => None,
    }
}
