//! `opspace explain`: prints the page of a code, or lists all codes.

use crate::console::{Exit, Outcome, print, wrapped};
use opspace_experiment::Code;
use opspace_experiment::codes::Effect;

/// Width of the names in the list.
const NAME_WIDTH: usize = 32;

pub fn explain(code: Option<Code>) -> Outcome {
    print(&code.map_or_else(list, page))?;
    Ok(Exit::Done)
}

fn page(code: Code) -> String {
    let effect = match code.effect() {
        Effect::RefusedOnRealRobot => format!(
            "Refuses a run on a real robot, and is reported otherwise; --allow {code} turns the refusal into a warning that results \
             carry."
        ),
        Effect::Refused => {
            format!("Refuses a run; --allow {code} turns the refusal into a warning that results carry.")
        }
        Effect::Never(reason) => format!("Refuses a run; this cannot be allowed: {reason}."),
        Effect::Noted => "Is noted after a run.".to_owned(),
        Effect::Failed => "Is reported after a run, which has failed.".to_owned(),
        _ => "Is reported; refuses no run.".to_owned(),
    };
    format!("{code}\n\n{}\n{}", wrapped(&effect), text(code.page()))
}

/// Page for a terminal: paragraphs are wrapped, blocks of code are indented.
fn text(page: &str) -> String {
    let (mut text, mut in_code) = (String::new(), false);
    for line in page.lines() {
        if line.starts_with("```") {
            in_code = !in_code;
        } else if in_code {
            text += &format!("    {line}\n");
        } else {
            text += &wrapped(&line.replace("**", ""));
        }
    }
    text
}

fn list() -> String {
    let line = |code: &Code| {
        let effect = match code.effect() {
            Effect::Refused | Effect::RefusedOnRealRobot => "refused, can be allowed",
            Effect::Never(_) => "refused",
            Effect::Noted => "noted after a run",
            Effect::Failed => "failure of a run",
            _ => "reported",
        };
        format!("{:<NAME_WIDTH$}  {effect:<23}  {}\n", code.name(), code.summary())
    };
    Code::ALL.iter().map(line).collect()
}
