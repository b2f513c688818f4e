//! Lists of names in messages.

/// Joins up to `most` names by commas and appends the number of the others: `a, b and 3 more`.
pub(crate) fn name_list<S: AsRef<str>>(names: &[S], most: usize) -> String {
    let shown: Vec<&str> = names.iter().take(most).map(AsRef::as_ref).collect();
    match names.len().saturating_sub(most) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}
