//! Short names of runs on a page: only what tells them apart.

use opspace_experiment::evaluate::grid_keys::{own_label, settings};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::files::source::KeyPath;
use opspace_experiment::run::physics::OWN_PLANT;

/// Kind of robot and its control: what has a colour of its own.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Kind {
    backend: String,
    controller: String,
    transformer: Option<String>,
    plant: Option<String>,
    robot: Option<String>,
}

/// Kinds in runs, in the order of the runs, with short names.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kinds {
    kinds: Vec<Kind>,
    /// True if a task is executed on several robots.
    several_robots: bool,
    pub(crate) names: Vec<String>,
}

impl Kinds {
    pub(crate) fn of<'a>(runs: impl Iterator<Item = &'a Summary> + Clone) -> Self {
        let several_robots = runs
            .clone()
            .any(|run| runs.clone().any(|other| other.task == run.task && other.robot != run.robot));
        let mut kinds = Self { several_robots, ..Self::default() };
        for run in runs {
            let kind = kinds.kind(run);
            if !kinds.kinds.contains(&kind) {
                kinds.kinds.push(kind);
            }
        }
        kinds.names = kinds.kinds.iter().map(|kind| kinds.name(kind)).collect();
        kinds
    }

    fn kind(&self, run: &Summary) -> Kind {
        Kind {
            backend: run.backend.clone(),
            controller: run.controller.clone(),
            transformer: run.transformer.clone(),
            plant: run.plant.clone().filter(|plant| plant != OWN_PLANT),
            robot: Some(run.robot.clone()).filter(|_| self.several_robots),
        }
    }

    /// Place of the kind of a run.
    pub(crate) fn place(&self, run: &Summary) -> usize {
        let kind = self.kind(run);
        self.kinds.iter().position(|known| *known == kind).unwrap_or(0)
    }

    fn name(&self, kind: &Kind) -> String {
        let differs = |of: &dyn Fn(&Kind) -> String| self.kinds.iter().any(|other| of(other) != of(kind));
        let control = |kind: &Kind| match (&kind.transformer, kind.controller.as_str()) {
            (Some(transformer), "osc") => transformer.clone(),
            (None, "osc") => String::new(),
            (_, controller) => controller.to_owned(),
        };
        let robot = format!("{} robot", kind.backend);
        let same_control = || {
            self.kinds.iter().filter(|other| control(other) == control(kind) && other.backend != kind.backend)
        };
        // A robot that has one kind of control is named by itself.
        let is_alone = |backend: &str| {
            let mut controls: Vec<String> =
                self.kinds.iter().filter(|other| other.backend == backend).map(control).collect();
            controls.dedup();
            controls.len() == 1
        };
        let backends_alone =
            self.kinds.iter().all(|kind| is_alone(&kind.backend) && kind.controller == "osc")
                && differs(&|kind| kind.backend.clone());
        let mut parts = vec![match control(kind) {
            _ if backends_alone => robot,
            control if control.is_empty() => robot,
            control if same_control().next().is_some() && kind.backend != "position" => {
                format!("{control}, {robot}")
            }
            control => control,
        }];
        let own = |plant: &Option<String>| plant.clone().unwrap_or_else(|| OWN_PLANT.to_owned());
        if differs(&|kind| own(&kind.plant)) {
            parts.push(match &kind.plant {
                Some(plant) => plant.clone(),
                None => "own plant".to_owned(),
            });
        }
        if differs(&|kind| kind.robot.clone().unwrap_or_default()) {
            parts.extend(kind.robot.clone());
        }
        parts.join(", ")
    }
}

/// Names of runs: kind, and what else differs between them.
pub(crate) fn run_names(runs: &[&Summary]) -> Vec<String> {
    let kinds = Kinds::of(runs.iter().copied());
    let several = |of: &dyn Fn(&Summary) -> String| runs.iter().any(|run| of(run) != of(runs[0]));
    let profile = |run: &Summary| format!("{} 1:{}", run.profile, run.ratio);
    let rest = |run: &Summary| rest(run).unwrap_or_default();
    let mut names: Vec<String> = Vec::new();
    for run in runs {
        let mut parts = Vec::new();
        if several(&|run| run.task.clone()) {
            parts.push(run.task.clone());
        }
        if kinds.names.len() > 1 {
            parts.push(kinds.names[kinds.place(run)].clone());
        }
        if several(&profile) {
            parts.push(profile(run));
        }
        if several(&rest) {
            parts.push(rest(run));
        }
        if several(&|run| run.seed.to_string()) {
            parts.push(format!("seed {}", run.seed));
        }
        parts.retain(|part| !part.is_empty());
        let name = if parts.is_empty() { format!("{} robot", run.backend) } else { parts.join(", ") };
        names.push(numbered(name, &names));
    }
    names
}

/// Name that none of the others has.
pub(crate) fn numbered(name: String, others: &[String]) -> String {
    let free = (2..).map(|number| format!("{name} ({number})")).find(|other| !others.contains(other));
    if others.contains(&name) { free.unwrap_or(name) } else { name }
}

/// Label of a run with the values of its grid, or its settings; `None` if it has neither.
pub(crate) fn label_or_settings(run: &Summary) -> Option<String> {
    let text = run.label.clone().unwrap_or_else(|| settings_text(run));
    (!text.is_empty()).then_some(text)
}

/// Settings of a run with the last words of their keys.
fn settings_text(run: &Summary) -> String {
    let setting =
        |(key, value): (&str, &str)| format!("{}={value}", key.segments().last().map_or(key, String::as_str));
    settings(run).map(setting).collect::<Vec<_>>().join(", ")
}

/// Label of the settings of a run, or the settings themselves; `None` if it has none.
pub(crate) fn rest(run: &Summary) -> Option<String> {
    const LONGEST: usize = 36;
    if run.label.is_some() {
        return own_label(run);
    }
    let text = settings_text(run);
    let short: String = text.chars().take(LONGEST).collect();
    let short = if short == text { text } else { format!("{short}…") };
    (!short.is_empty()).then_some(short)
}

/// Text with a capital at its beginning.
pub(crate) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
