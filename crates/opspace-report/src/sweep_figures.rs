//! Figures of the columns of a suite over a setting that is swept: a panel per task, profile and further setting, a line per
//! kind of robot and control, and a band for the interval over the seeds.

use crate::figure::{Figure, Panel, Scale, Series, Style};
use crate::kinds::{Kinds, sentence};
use opspace_experiment::evaluate::grid_keys::{GridKey, settings};
use opspace_experiment::evaluate::results::Group;
use opspace_experiment::evaluate::spread::Spread;
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::files::source::KeyPath;
use opspace_experiment::metrics::metric::{Column, Metric};
use std::ops::Range;

/// Ratio of the largest to the smallest value from which on an axis is logarithmic.
const DECADE: f64 = 10.0;
/// Number of characters of a title that has room beside a panel.
const LONGEST_LABEL: usize = 24;

/// Groups of a suite that are points of one sweep.
struct Sweep<'a> {
    /// Key on the abscissa.
    key: GridKey,
    points: Vec<Point<'a>>,
}

struct Point<'a> {
    x: f64,
    /// Name of the panel.
    panel: String,
    group: &'a Group<'a>,
}

/// Draws each column over the settings that are swept; returns the figures and the groups that are in none.
pub(crate) fn sweeps<'a>(
    groups: &'a [Group<'a>],
    kinds: &Kinds,
    columns: &[(&Metric, Column)],
) -> (Vec<Figure>, Vec<&'a Group<'a>>) {
    let (sweeps, rest) = found(groups, kinds);
    let figures = sweeps.iter().flat_map(|sweep| {
        columns.iter().filter_map(|(metric, column)| figure(sweep, kinds, metric, column)).collect::<Vec<_>>()
    });
    (figures.collect(), rest)
}

/// Groups that differ only in the values of their settings.
struct Family<'a> {
    members: Vec<&'a Group<'a>>,
    /// Keys whose values vary.
    varied: Vec<String>,
}

impl<'a> Family<'a> {
    fn all(groups: &'a [Group<'a>], kinds: &Kinds) -> Vec<Self> {
        let keys = |run: &Summary| settings(run).map(|(key, _)| key.to_owned()).collect::<Vec<_>>();
        let same = |a: &Summary, b: &Summary| {
            a.task == b.task
                && a.robot == b.robot
                && a.profile == b.profile
                && kinds.place(a) == kinds.place(b)
                && keys(a) == keys(b)
        };
        let mut families: Vec<Self> = Vec::new();
        for group in groups {
            match families.iter_mut().find(|family| same(family.members[0].first(), group.first())) {
                Some(family) => family.members.push(group),
                None => families.push(Self { members: vec![group], varied: Vec::new() }),
            }
        }
        for family in &mut families {
            let own = keys(family.members[0].first());
            family.varied = own.into_iter().filter(|key| family.texts(key).len() > 1).collect();
        }
        families
    }

    fn texts(&self, key: &str) -> Vec<&'a str> {
        let mut texts: Vec<&str> = self.members.iter().filter_map(|group| text(group.first(), key)).collect();
        texts.sort_unstable();
        texts.dedup();
        texts
    }

    /// Values of a key; `None` if they are not three numbers or more.
    fn numbers(&self, key: &str) -> Option<Vec<f64>> {
        let numbers: Option<Vec<f64>> = self.texts(key).into_iter().map(|text| text.parse().ok()).collect();
        numbers.filter(|numbers| numbers.len() > 2 && numbers.iter().all(|number| number.is_finite()))
    }
}

fn text<'a>(run: &'a Summary, key: &str) -> Option<&'a str> {
    settings(run).filter(|(own, _)| *own == key).last().map(|(_, value)| value)
}

fn found<'a>(groups: &'a [Group<'a>], kinds: &Kinds) -> (Vec<Sweep<'a>>, Vec<&'a Group<'a>>) {
    let families = Family::all(groups, kinds);
    let mut keys: Vec<&str> = Vec::new();
    for key in families.iter().flat_map(|family| &family.varied) {
        if !keys.contains(&key.as_str()) {
            keys.push(key);
        }
    }
    // A wide range of values is the more important one.
    let rank = |key: &&str| {
        let most = families.iter().filter_map(|family| Some(ratio(&family.numbers(key)?)));
        most.fold(0.0, f64::max)
    };
    keys.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
    let named = named(&keys, &families);
    let several =
        |of: fn(&Summary) -> &str| groups.iter().any(|group| of(group.first()) != of(groups[0].first()));
    let (tasks, profiles) = (several(|run| &run.task), several(|run| &run.profile));
    let (mut sweeps, mut rest): (Vec<Sweep<'a>>, Vec<&'a Group<'a>>) = (Vec::new(), Vec::new());
    for family in families {
        let is_varied =
            |key: &&GridKey| family.varied.contains(&key.key) && family.numbers(&key.key).is_some();
        let Some(key) = named.iter().find(is_varied) else {
            rest.extend(family.members);
            continue;
        };
        let others: Vec<&GridKey> =
            named.iter().filter(|other| *other != key && family.varied.contains(&other.key)).collect();
        let names = |run: &Summary| {
            let name = |key: &&GridKey| {
                let value = key.text(run).unwrap_or("–").trim_matches('"');
                let number: Option<f64> = value.parse().ok();
                let value = number.map_or_else(|| value.to_owned(), |number| number.to_string());
                let unit = if key.unit == "true/nominal" { "" } else { key.unit };
                format!("{} {value} {unit}", key.name).trim_end().to_owned()
            };
            others.iter().map(name).collect::<Vec<_>>().join(", ")
        };
        // A setting that changes along with the one on the axis distinguishes no lines.
        let all: Vec<String> = family.members.iter().map(|group| names(group.first())).collect();
        let is_crossed = all.iter().any(|own| all.iter().filter(|other| *other == own).count() > 1);
        let mut points: Vec<Point<'_>> = Vec::new();
        for (group, other) in family.members.iter().zip(all) {
            let run = group.first();
            let Some(x) = key.number(run) else { continue };
            let parts = [
                if tasks { run.task.as_str() } else { "" },
                if profiles { run.profile.as_str() } else { "" },
                if is_crossed { other.as_str() } else { "" },
            ];
            let panel = parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(", ");
            match points.iter().any(|point| point.x == x && point.panel == panel) {
                true => rest.push(*group),
                false => points.push(Point { x, panel, group }),
            }
        }
        match sweeps.iter_mut().find(|sweep| sweep.key.title() == key.title()) {
            Some(sweep) => sweep.points.extend(points),
            None => sweeps.push(Sweep { key: key.clone(), points }),
        }
    }
    (sweeps, rest)
}

/// Names of keys: the last word where no family has two such keys, as the stiffnesses of walls with different names.
fn named(keys: &[&str], families: &[Family<'_>]) -> Vec<GridKey> {
    let last = |key: &str| key.segments().pop().unwrap_or_default();
    let is_alone = |key: &str| {
        let own = |other: &&String| last(other) == last(key);
        families.iter().all(|family| family.varied.iter().filter(own).count() < 2)
    };
    let rename = |key: GridKey| match is_alone(&key.key) {
        true => GridKey { key: key.key.clone(), ..GridKey::named(&[&key.key]).remove(0) },
        false => key,
    };
    GridKey::named(keys).into_iter().map(rename).collect()
}

/// Ratio of the largest to the smallest value; 1 if one is not positive.
fn ratio(values: &[f64]) -> f64 {
    let (low, high) =
        values.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &value| (low.min(value), high.max(value)));
    if low > 0.0 && high.is_finite() { high / low } else { 1.0 }
}

/// Scale on which all values can be told apart.
fn scale(values: &[f64]) -> Scale {
    if ratio(values) >= DECADE { Scale::Log } else { Scale::Linear }
}

fn figure(sweep: &Sweep<'_>, kinds: &Kinds, metric: &Metric, column: &Column) -> Option<Figure> {
    type Place<'a> = (&'a Point<'a>, Spread);
    let places: Vec<Place<'_>> = sweep
        .points
        .iter()
        .filter_map(|point| Some((point, point.group.of_column(metric, column)?)))
        .filter(|(_, spread)| spread.median.is_finite())
        .collect();
    let mut panels: Vec<&str> = Vec::new();
    for (point, _) in &places {
        if !panels.contains(&point.panel.as_str()) {
            panels.push(&point.panel);
        }
    }
    let mut ticks: Vec<f64> = places.iter().map(|(point, _)| point.x).collect();
    ticks.sort_by(f64::total_cmp);
    ticks.dedup();
    if ticks.len() < 2 {
        return None;
    }
    let values: Vec<f64> =
        places.iter().flat_map(|(_, spread)| [spread.low, spread.median, spread.high]).collect();
    if values.iter().all(|value| *value == 0.0) {
        return None;
    }
    let y_scale = scale(&values);
    let mut y_range = range_of(&values);
    if y_scale == Scale::Linear {
        y_range = y_range.start.min(0.0)..y_range.end.max(0.0);
    }
    let panel = |name: &&str| {
        let mut series = Vec::new();
        for (kind, label) in kinds.names.iter().enumerate() {
            let is_own =
                |(point, _): &&Place<'_>| point.panel == **name && kinds.place(point.group.first()) == kind;
            let mut own: Vec<&Place<'_>> = places.iter().filter(is_own).collect();
            own.sort_by(|(a, _), (b, _)| a.x.total_cmp(&b.x));
            let x: Vec<f64> = own.iter().map(|(point, _)| point.x).collect();
            let along =
                |of: fn(&Spread) -> f64| own.iter().map(|(_, spread)| of(spread)).collect::<Vec<f64>>();
            let (low, high) = (along(|s| s.low), along(|s| s.high));
            if low != high && x.len() > 1 {
                let around = x.iter().chain(x.iter().rev()).copied().collect();
                let y = low.into_iter().chain(high.into_iter().rev()).collect();
                series.push(Series::new(label, around, y).style(Style::Band).color(kind));
            }
            if !x.is_empty() {
                series.push(Series::new(label, x, along(|s| s.median)).style(Style::Marked).color(kind));
            }
        }
        Panel {
            title: (*name).to_owned(),
            x_label: sweep.key.title(),
            y_label: label_of(column),
            series,
            x_scale: scale(&ticks),
            y_scale,
            x_ticks: ticks.clone(),
            y_range: Some(y_range.clone()),
            ..Panel::default()
        }
    };
    let count = panels.len();
    let has_bands = places.iter().any(|(_, spread)| spread.high > spread.low);
    let bands = if has_bands { " Bands are the intervals of the table." } else { "" };
    Some(Figure {
        title: format!("{} over {}", sentence(column.title), sweep.key.name),
        caption: format!("Medians over the seeds.{bands}"),
        columns: Some(if count == 4 { 2 } else { count.min(3) }),
        panels: panels.iter().map(panel).collect(),
        ..Figure::default()
    })
}

fn range_of(values: &[f64]) -> Range<f64> {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    finite().fold(f64::INFINITY, f64::min)..finite().fold(f64::NEG_INFINITY, f64::max)
}

/// Title of an ordinate, with its unit: the whole one if it has room there, otherwise its first two words.
fn label_of(column: &Column) -> String {
    let unit = if column.unit.is_empty() { String::new() } else { format!(" ({})", column.unit) };
    let whole = format!("{}{unit}", column.title);
    if whole.chars().count() <= LONGEST_LABEL {
        return whole;
    }
    let words: Vec<&str> = column.title.split(' ').take(2).collect();
    format!("{}{unit}", words.join(" "))
}
