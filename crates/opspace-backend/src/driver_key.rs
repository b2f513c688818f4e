//! Keys of `[driver]`, as a driver declares them: files are checked with them, and pages list them.

/// Key of `[driver]` other than `name`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DriverKey {
    /// Name of the key.
    pub name: &'static str,
    /// Kind of its value.
    pub value: KeyValue,
    /// True if a robot cannot be opened without it.
    pub is_required: bool,
    /// Default in words; empty if nothing takes the place of the key.
    pub default: &'static str,
    /// Meaning, a sentence in Markdown.
    pub meaning: &'static str,
}

/// Kind of a key's value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum KeyValue {
    /// A string.
    Text,
    /// A number.
    Number,
    /// true or false.
    Flag,
    /// An array of strings.
    Texts,
    /// An array of numbers.
    Numbers,
    /// A string for each joint: an array in their order, or a table by their names.
    TextsByJoint,
    /// A number for each joint: an array in their order, or a table by their names.
    NumbersByJoint,
}

impl DriverKey {
    /// Returns an optional key without a default.
    #[must_use]
    pub const fn new(name: &'static str, value: KeyValue, meaning: &'static str) -> Self {
        Self { name, value, is_required: false, default: "", meaning }
    }

    /// Makes the key required.
    #[must_use]
    pub const fn required(self) -> Self {
        Self { is_required: true, ..self }
    }

    /// Sets the default, in words.
    #[must_use]
    pub const fn with_default(self, default: &'static str) -> Self {
        Self { default, ..self }
    }
}

impl KeyValue {
    /// Kind of the value in words, for pages.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Text => "string",
            Self::Number => "number",
            Self::Flag => "`true` or `false`",
            Self::Texts => "list: string",
            Self::Numbers => "list: number",
            Self::TextsByJoint => "list: string, or table by joint: string",
            Self::NumbersByJoint => "list: number, or table by joint: number",
        }
    }
}
