//! Fenced blocks of Markdown pages.

/// A fenced block.
pub struct Block {
    /// Line of its fence, from 1.
    pub line: usize,
    pub language: String,
    pub text: String,
}

/// A command of a `console` block.
pub struct Command {
    pub text: String,
    /// Lines of its output.
    pub output: Vec<String>,
    pub exit: i32,
}

/// Returns the fenced blocks of a page.
pub fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    for (k, line) in page.lines().enumerate() {
        match (line.trim_start().strip_prefix("```"), &mut open) {
            (Some(language), None) => {
                let language = language.split([',', ' ']).next().unwrap_or_default().to_owned();
                open = Some(Block { line: k + 1, language, text: String::new() });
            }
            (Some(_), Some(_)) => blocks.extend(open.take()),
            (None, Some(block)) => {
                block.text += line;
                block.text.push('\n');
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a block is not closed");
    blocks
}

/// Name of the file that a block is, or is an excerpt of, from the comment in its first line.
pub fn file_name(block: &Block, comment: &str) -> Option<String> {
    let name = block.text.lines().next()?.strip_prefix(comment)?;
    let is_name = !name.contains(' ') && name.contains('.') && !name.ends_with('.');
    is_name.then(|| name.to_owned())
}

/// Returns the commands of a `console` block.
pub fn commands(block: &Block) -> Vec<Command> {
    let mut commands: Vec<Command> = Vec::new();
    for line in block.text.lines() {
        if let Some(text) = line.strip_prefix("$ ") {
            let (text, comment) = text.split_once("  # ").unwrap_or((text, ""));
            let exit = comment.split_once("exit code ").map_or(0, |(_, code)| {
                let digits: String = code.chars().take_while(char::is_ascii_digit).collect();
                digits.parse().expect("a number")
            });
            commands.push(Command { text: text.trim().to_owned(), output: Vec::new(), exit });
        } else if let Some(command) = commands.last_mut() {
            // A command that is continued.
            if let Some(begin) = command.text.strip_suffix('\\').filter(|_| command.output.is_empty()) {
                command.text = format!("{begin}{}", line.trim());
            } else if !line.trim().is_empty() && line.trim() != "…" {
                command.output.push(line.trim_end_matches('…').to_owned());
            }
        }
    }
    commands
}
