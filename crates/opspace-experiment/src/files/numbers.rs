//! Numbers as people write them, `.3` and `1.`, in the form of TOML: with a digit on both sides of the point.

/// Characters between the words of a value.
const SEPARATORS: [char; 8] = ['[', ']', '{', '}', ',', '=', ' ', '\t'];

/// Returns a text in which all such numbers outside of quotes are in the form of TOML, and the first of them in both forms;
/// `None` if there is none.
pub(crate) fn with_digits(text: &str) -> Option<(String, [String; 2])> {
    let (mut corrected, mut first) = (String::new(), None);
    let mut quote = None;
    for word in text.split_inclusive(|c| SEPARATORS.contains(&c) || c == '#') {
        let is_quoted = quote.is_some();
        for c in word.chars().filter(|c| matches!(c, '"' | '\'')) {
            quote = match quote {
                None => Some(c),
                Some(open) if open == c => None,
                open => open,
            };
        }
        let number = word.trim_end_matches(SEPARATORS);
        match in_toml(number).filter(|_| !is_quoted) {
            Some(form) => {
                corrected += &form;
                corrected += &word[number.len()..];
                first.get_or_insert([number.to_owned(), form]);
            }
            None => corrected += word,
        }
        if word.ends_with('#') && quote.is_none() {
            break;
        }
    }
    first.map(|first| (corrected, first))
}

/// Returns a number in the form of TOML; `None` if the word is no number, or has this form.
fn in_toml(word: &str) -> Option<String> {
    let has_only_digits = word.chars().all(|c| c.is_ascii_digit() || "+-.eE".contains(c));
    if !has_only_digits || word.parse::<f64>().is_err() {
        return None;
    }
    let (before, after) = word.split_once('.')?;
    let ends_in_digit = before.ends_with(|c: char| c.is_ascii_digit());
    let begins_with_digit = after.starts_with(|c: char| c.is_ascii_digit());
    let zero = |is_there: bool| if is_there { "" } else { "0" };
    let corrected = format!("{before}{}.{}{after}", zero(ends_in_digit), zero(begins_with_digit));
    (corrected != word).then_some(corrected)
}

#[cfg(test)]
mod tests {
    use super::with_digits;

    #[test]
    fn numbers_get_the_digits_that_toml_needs() {
        for (text, corrected) in [
            (".3", "0.3"),
            ("1.", "1.0"),
            ("+.5", "+0.5"),
            ("-1.e3", "-1.0e3"),
            ("[.3, 1., 2.5]", "[0.3, 1.0, 2.5]"),
            ("{ x = .1, y = '.2' }", "{ x = 0.1, y = '.2' }"),
        ] {
            assert_eq!(
                with_digits(text).map(|(corrected, _)| corrected).as_deref(),
                Some(corrected),
                "{text}"
            );
        }
        for text in ["1e3", "0.3", "1", "\".3\"", "a.b", ".", "...", "./a", "1.2.3", "x # .3"] {
            assert_eq!(with_digits(text), None, "{text}");
        }
    }
}
