//! Codes of diagnostics, refusals and warnings: each has a page and a place that reports it, and each page a code.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_experiment::Code;
use opspace_experiment::codes::{Effect, allowed_code};
use opspace_model::collision::CapsuleWarning;
use opspace_model::{ModelWarning, UrdfWarningKind};
use std::fs;
use std::path::Path;

/// Codes of the warnings about models, which `opspace-model` names.
fn of_models() -> Vec<&'static str> {
    let all = [&UrdfWarningKind::CODES[..], &ModelWarning::CODES, &CapsuleWarning::CODES];
    all.concat()
}

/// Texts of all source files below a folder.
fn sources(folder: &Path) -> String {
    let mut text = String::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            text += &sources(&path);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            text += &fs::read_to_string(&path).unwrap();
        }
    }
    text
}

#[test]
fn each_code_has_a_page_and_each_page_a_code() {
    let names: Vec<&str> = Code::ALL.iter().map(|code| code.name()).collect();
    assert_eq!(Code::pages(), names);
    for code in Code::ALL {
        let page = code.page();
        for part in ["**Why it matters.** ", "**What to do.** ", "**Example.**"] {
            assert_eq!(page.matches(part).count(), 1, "{code}: {part}");
        }
        let what = page.split("\n\n").next().unwrap();
        assert!(what.ends_with('.') && !what.starts_with('*'), "{code}: {what}");
        assert!(!code.summary().is_empty() && !code.summary().contains('\n'), "{code}");
        assert_eq!(page.matches("```").count() % 2, 0, "{code}");
        // A page that names the option agrees with the effect.
        let can_be_allowed = matches!(code.effect(), Effect::Refused | Effect::RefusedOnRealRobot);
        assert_eq!(page.contains(&format!("--allow {code}")), can_be_allowed, "{code}");
    }
}

/// Each code is used by a source file of this crate or of the diagnostics, or is that of a warning about a model: no page without a kind.
#[test]
fn each_code_is_reported_by_something() {
    let crates = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let source =
        ["opspace-experiment/src", "opspace-preflight/src"].map(|folder| sources(&crates.join(folder)));
    let source = source.concat();
    let of_models = of_models();
    for code in Code::ALL {
        let used = source.contains(&format!("Code::{code:?}"));
        assert_ne!(used, of_models.contains(&code.name()), "{code}");
    }
    for name in of_models {
        assert_eq!(name.parse::<Code>().unwrap().name(), name);
    }
}

#[test]
fn only_refusals_that_falsify_nothing_can_be_allowed() {
    for code in Code::ALL {
        match (allowed_code(code.name()), code.effect()) {
            (Ok(allowed), Effect::Refused | Effect::RefusedOnRealRobot) => assert_eq!(allowed, *code),
            (Err(message), Effect::Never(reason)) => {
                assert_eq!(message, format!("'{code}' cannot be allowed: {reason}"));
            }
            (Err(message), Effect::Reported | Effect::Noted | Effect::Failed) => {
                assert!(message.contains("only reported"), "{message}")
            }
            (result, effect) => panic!("{code}: {result:?}, {effect:?}"),
        }
    }
    let unknown = allowed_code("gear-oscilation").unwrap_err();
    assert!(unknown.contains("did you mean 'gear-oscillation'?"), "{unknown}");
}
