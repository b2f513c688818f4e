//! Text that describes a direction in the rows of a task.

/// Smallest component that is named, of a unit vector.
const NAMED: f64 = 0.05;

/// Describes a direction (unit vector over the rows `names`): `z`, or `0.71 x - 0.71 rz`. Its sign is arbitrary: the
/// largest component is positive.
pub fn direction(direction: &[f64], names: &[String]) -> String {
    let largest = direction.iter().copied().reduce(|a, b| if b.abs() > a.abs() { b } else { a });
    let sign = largest.map_or(1.0, f64::signum);
    let mut text = String::new();
    for (part, name) in direction.iter().zip(names) {
        let part = sign * part;
        if part.abs() < NAMED {
            continue;
        }
        let joined = match (text.is_empty(), part < 0.0) {
            (true, false) => "",
            (true, true) => "-",
            (false, false) => " + ",
            (false, true) => " - ",
        };
        text += joined;
        if part.abs() < 0.995 {
            text += &format!("{:.2} ", part.abs());
        }
        text += name;
    }
    text
}
