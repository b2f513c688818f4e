//! `opspace log`: contents, recovery, export and comparison of logs.

use super::export_path::PathExport;
use crate::cli::{LogCommand, LogDiffArgs, LogExportArgs, LogInfoArgs, LogRecoverArgs};
use crate::console::{Console, Exit, Failure, Outcome, render};
use crate::output::{Format, log_path, open_log, pretty, unreadable};
use crate::outputs::check_outputs;
use opspace_backend::signal_names::{MISSED_CYCLES, TICK_CHANNEL};
use opspace_experiment::evaluate::table::{Cell, Table};
use opspace_experiment::run::log_header::RUN;
use opspace_experiment::run::result_files::write_file_with;
use opspace_log::{
    ChannelComparison, Column, CsvWriter, LOG, LogComparison, LogError, LogFile, OutcomeRecord,
    PartDifference, RECOVERED, Recording, Recovery, compare_logs, recover as recover_log,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{self, BufWriter, Write};
use std::path::Path;

pub fn log(command: &LogCommand, console: Console) -> Outcome {
    match command {
        LogCommand::Info(args) => info(args),
        LogCommand::Recover(args) => recover(args),
        LogCommand::Export(args) => export(args, console),
        LogCommand::Diff(args) => diff(args),
    }
}

fn info(args: &LogInfoArgs) -> Outcome {
    check_outputs(&[log_path(&args.log)], &Vec::from_iter(args.json.path().map(Path::to_owned)))?;
    let (path, log) = open_log(&args.log)?;
    let numbers = Numbers::of(&log).map_err(|error| unreadable(&path, &error))?;
    args.json.print(|| pretty(&info_json(&path, &log, &numbers)), || describe(&path, &log, &numbers))?;
    let damaged = log.recording().damage.is_some() || log.recording().dropped() > 0;
    Ok(if damaged { Exit::DataLost } else { Exit::Done })
}

/// Numbers of a log, computed from its channel `tick`.
struct Numbers {
    cycles: u64,
    missed_cycles: f64,
    duration_s: f64,
}

impl Numbers {
    fn of(log: &LogFile) -> Result<Self, LogError> {
        let (cycles, span_s) = log.rows(TICK_CHANNEL);
        let [first, last] = span_s.unwrap_or_default();
        let mut missed_cycles = 0.0;
        log.for_each_segment(&mut |segment, _| {
            let missed = segment.channel(TICK_CHANNEL).and_then(|tick| tick.signal(MISSED_CYCLES));
            let missed = missed.into_iter().flat_map(Column::rows).map(|row| row[0]);
            missed_cycles += missed.filter(|missed| missed.is_finite()).sum::<f64>();
        })?;
        Ok(Self { cycles, missed_cycles, duration_s: last - first })
    }
}

/// Entries of the run's metadata that name it, in the order of the text.
const ORIGIN: [&str; 10] = [
    "task",
    "robot",
    "backend",
    "controller",
    "profile",
    "seed",
    "world",
    "plant",
    "plant_version",
    "plant_scene",
];

fn entry<'r>(recording: &'r Recording, record: &str, key: &str) -> Option<&'r str> {
    recording.metadata(record)?.get(key).map(String::as_str)
}

/// Text on the state of a log: closed, recovered, damaged.
fn states(recording: &Recording) -> Vec<String> {
    let mut states = Vec::new();
    states.push(match recording.closed {
        true => "closed by its writer".to_owned(),
        false => "not closed: its writer was stopped, or the file was cut short".to_owned(),
    });
    if let Some(damage) = &recording.damage {
        let place = damage.at_byte.map_or_else(String::new, |at| format!(", from byte {at}"));
        states.push(format!("damaged{place}: {damage}"));
    }
    states.extend(recording.damaged_parts.iter().map(|part| format!("lost: {part}")));
    if let Some(damage) = entry(recording, RECOVERED, "damage") {
        states.push(format!("recovered from a damaged log: {damage}"));
    }
    if recording.dropped() > 0 {
        states.push(format!("{} rows were dropped during the run", recording.dropped()));
    }
    states
}

fn outcome(recording: &Recording) -> String {
    let outcome = OutcomeRecord::of(recording);
    let at = outcome.time_s.map_or_else(String::new, |time_s| format!(" at {time_s} s"));
    match (&outcome.fault, outcome.interrupted, recording.metadata(opspace_log::outcome::OUTCOME)) {
        (Some(fault), ..) => format!("stopped{at}: {fault}"),
        (None, true, _) => format!("interrupted{at}"),
        (None, false, Some(_)) => "completed".to_owned(),
        (None, false, None) => "unknown: the log has no record of it".to_owned(),
    }
}

fn describe(path: &Path, log: &LogFile, numbers: &Numbers) -> String {
    let recording = log.recording();
    let mut text = format!("{}: {} bytes\n", path.display(), log.size_bytes());
    states(recording).iter().for_each(|state| text += &format!("  {state}\n"));
    for key in ORIGIN {
        if let Some(value) = entry(recording, RUN, key) {
            text += &format!("  {key}: {value}\n");
        }
    }
    let version = entry(recording, LOG, "version").unwrap_or(&recording.library);
    text += &format!("  version: {version}\n");
    text += &format!("  outcome: {}\n", outcome(recording));
    text += &format!(
        "  {} cycles in {:.3} s, {} missed cycles\n\n",
        numbers.cycles, numbers.duration_s, numbers.missed_cycles
    );
    let mut channels = Table::new(&[("channel", ""), ("type", ""), ("messages", ""), ("size", "bytes")]);
    for channel in log.channels() {
        let texts = [&channel.topic, &channel.schema].map(|text| Cell::from(text.clone()));
        channels.push(
            texts.into_iter().chain([Cell::Count(channel.messages), Cell::Count(channel.bytes)]).collect(),
        );
    }
    let mut parts = Table::new(&[("attachment or metadata", ""), ("size", "bytes")]);
    for attachment in &recording.attachments {
        parts.push(vec![attachment.name.clone().into(), Cell::Count(attachment.data.len() as u64)]);
    }
    for (name, entries) in &recording.metadata {
        parts.push(vec![name.clone().into(), Cell::Count(size(entries))]);
    }
    text + &render(&channels) + "\n" + &render(&parts)
}

/// Size of the texts of a metadata record, bytes.
fn size(entries: &BTreeMap<String, String>) -> u64 {
    entries.iter().map(|(key, value)| (key.len() + value.len()) as u64).sum()
}

fn info_json(path: &Path, log: &LogFile, numbers: &Numbers) -> Value {
    let recording = log.recording();
    let channel = |channel: &opspace_log::ChannelContents| {
        json!({
            "topic": channel.topic,
            "type": channel.schema,
            "messages": channel.messages,
            "bytes": channel.bytes,
        })
    };
    let attachments: Vec<Value> = (recording.attachments.iter())
        .map(|a| json!({ "name": a.name, "media_type": a.media_type, "bytes": a.data.len() }))
        .collect();
    let metadata: Vec<Value> = (recording.metadata.iter())
        .map(|(name, entries)| json!({ "name": name, "bytes": size(entries), "entries": entries }))
        .collect();
    let origin = |key: &str| entry(recording, RUN, key);
    json!({
        "schema": "opspace.log-info/1",
        "log": path,
        "bytes": log.size_bytes(),
        "closed": recording.closed,
        "damage": recording.damage.as_ref().map(|damage| json!({
            "what": damage.what,
            "at_byte": damage.at_byte,
            "after_s": damage.after_s,
            "rows_lost": damage.rows_lost,
        })),
        "damaged_parts": recording.damaged_parts,
        "recovered": recording.metadata(RECOVERED),
        "version": entry(recording, LOG, "version"),
        "library": recording.library,
        "task": origin("task"),
        "robot": origin("robot"),
        "backend": origin("backend"),
        "controller": origin("controller"),
        "profile": origin("profile"),
        "seed": origin("seed"),
        "plant": origin("plant"),
        "plant_version": origin("plant_version"),
        "outcome": outcome(recording),
        "duration_s": numbers.duration_s,
        "cycles": numbers.cycles,
        "missed_cycles": numbers.missed_cycles,
        "rows_dropped": recording.dropped(),
        "channels": log.channels().iter().map(channel).collect::<Vec<_>>(),
        "attachments": attachments,
        "metadata": metadata,
    })
}

fn recover(args: &LogRecoverArgs) -> Outcome {
    let input = log_path(&args.log);
    let outputs: Vec<_> =
        [Some(args.out.as_path()), args.json.path()].into_iter().flatten().map(Path::to_owned).collect();
    check_outputs(&[input], &outputs)?;
    if args.out.symlink_metadata().is_ok() {
        let text = format!(
            "{}: already exists, and a recovery replaces no file; choose another file with --out",
            args.out.display()
        );
        return Err(Failure::Other(text, Exit::Bad));
    }
    let (path, log) = open_log(&args.log)?;
    let mut result = None;
    let written = write_file_with(&args.out, |file| {
        result = Some(recover_log(&log, file));
        match &result {
            Some(Err(error)) => Err(io::Error::other(error.to_string())),
            _ => Ok(()),
        }
    });
    let recovery = match (result, written) {
        (Some(Err(LogError::Write(error))), _) | (Some(Ok(_)) | None, Err(error)) => {
            return Err(Failure::io("cannot be written", &args.out, &error));
        }
        (Some(Err(error)), _) => return Err(unreadable(&path, &error)),
        (Some(Ok(recovery)), Ok(())) => recovery,
        (None, Ok(())) => return Ok(Exit::Failed),
    };
    let planned = entry(log.recording(), RUN, "duration_s").and_then(|s| s.parse::<f64>().ok());
    args.json.print(
        || pretty(&recovery_json(&path, &args.out, &recovery)),
        || recovery_text(&path, &args.out, &recovery, planned),
    )?;
    Ok(if recovery.data_lost() { Exit::DataLost } else { Exit::Done })
}

fn recovery_text(path: &Path, out: &Path, recovery: &Recovery, planned_s: Option<f64>) -> String {
    let mut text = match &recovery.damage {
        None => format!("{}: whole\n", path.display()),
        Some(damage) => format!("{}: damaged: {damage}\n", path.display()),
    };
    text += &format!("  saved: {} cycles, {:.3} s\n", recovery.cycles, recovery.duration_s);
    text += &match (recovery.lost_cycles, recovery.lost_s) {
        (Some(cycles), Some(seconds)) => format!("  lost: {cycles} cycles, {seconds:.3} s\n"),
        _ => {
            let planned = planned_s.map_or_else(String::new, |s| format!("; {s} s of control were planned"));
            format!("  lost: unknown, because the log has no end{planned}\n")
        }
    };
    recovery.lost_parts.iter().for_each(|part| text += &format!("  lost: {part}\n"));
    text + &format!("{}\n", out.display())
}

fn recovery_json(path: &Path, out: &Path, recovery: &Recovery) -> Value {
    json!({
        "schema": "opspace.log-recovery/1",
        "log": path,
        "recovered": out,
        "damage": recovery.damage.as_ref().map(ToString::to_string),
        "cycles": recovery.cycles,
        "duration_s": recovery.duration_s,
        "lost_cycles": recovery.lost_cycles,
        "lost_s": recovery.lost_s,
        "lost_parts": recovery.lost_parts,
    })
}

fn export(args: &LogExportArgs, console: Console) -> Outcome {
    let out = (args.out != Path::new("-")).then_some(args.out.as_path());
    check_outputs(&[log_path(&args.log)], &Vec::from_iter(out.map(Path::to_owned)))?;
    if let Some(out) = out.filter(|out| out.is_file()) {
        let reason = match (args.force, Format::LogCsv.is_that_of(out)) {
            (true, true) => None,
            (true, false) => Some(format!(
                "exists and is not {}; choose another file for the output",
                Format::LogCsv.name()
            )),
            (false, _) => Some("already exists; use --force to replace it".to_owned()),
        };
        if let Some(reason) = reason {
            return Err(Failure::Other(format!("{}: {reason}", out.display()), Exit::Bad));
        }
    }
    let (path, log) = open_log(&args.log)?;
    let recording = log.recording();
    let channels = &recording.channels;
    if recording.channel(&args.channel).is_none() {
        let known: Vec<&str> = channels.iter().map(|c| c.layout.channel.as_str()).collect();
        let text =
            format!("{}: no channel '{}'; its channels: {}", path.display(), args.channel, known.join(", "));
        return Err(Failure::Other(text, Exit::Bad));
    }
    let of_frame = args.path.as_ref().map(|task| PathExport::new(&log, task, args.every_s)).transpose()?;
    let export = |sink: &mut dyn Write| match &of_frame {
        Some(path) => path.write(&log, sink),
        None => export_rows(&log, &args.channel, sink),
    };
    match out {
        Some(out) => write_file_with(out, |file| export(&mut BufWriter::new(file)))
            .map_err(|error| Failure::io("cannot be written", out, &error))?,
        None => {
            let mut stdout = BufWriter::new(io::stdout().lock());
            export(&mut stdout).map_err(|error| Failure::stdout(&error))?;
        }
    }
    if let Some(damage) = &recording.damage {
        console.note(&format!("{}: damaged: {damage}", path.display()));
    }
    let lost = recording.damage.is_some() || recording.dropped() > 0;
    Ok(if lost { Exit::DataLost } else { Exit::Done })
}

/// Writes the rows of a channel as CSV.
fn export_rows(log: &LogFile, name: &str, sink: impl Write) -> io::Result<()> {
    let Some(channel) = log.recording().channel(name) else { return Ok(()) };
    let mut csv = CsvWriter::new(&channel.layout, sink)?;
    let mut written = Ok(());
    log.for_each_segment(&mut |segment, _| {
        if let Some(rows) = segment.channel(name).filter(|_| written.is_ok()) {
            written = csv.write_rows(rows);
        }
    })
    .map_err(io::Error::other)?;
    written.and_then(|()| csv.flush())
}

fn diff(args: &LogDiffArgs) -> Outcome {
    let inputs = [log_path(&args.first), log_path(&args.second)];
    check_outputs(&inputs, &Vec::from_iter(args.json.path().map(Path::to_owned)))?;
    let (first, a) = open_log(&args.first)?;
    let (second, b) = open_log(&args.second)?;
    let paths = [first.as_path(), second.as_path()];
    let comparison = compare_logs(&a, &b).map_err(|(which, error)| unreadable(paths[which], &error))?;
    args.json.print(|| pretty(&diff_json(paths, &comparison)), || diff_text(paths, &comparison))?;
    let lost = comparison.is_damaged() || [&a, &b].iter().any(|log| log.recording().dropped() > 0);
    Ok(match (comparison.differs(), lost) {
        (true, _) => Exit::Failed,
        (false, true) => Exit::DataLost,
        (false, false) => Exit::Done,
    })
}

fn diff_text(paths: [&Path; 2], comparison: &LogComparison) -> String {
    let mut text = String::new();
    for (path, damage) in paths.iter().zip(&comparison.damage) {
        if let Some(damage) = damage {
            text += &format!("{}: damaged: {damage}\n", path.display());
        }
    }
    for channel in &comparison.channels {
        text += &channel_text(channel);
    }
    for PartDifference { part, place, values, .. } in &comparison.parts {
        text += &match (place, values) {
            (None, [Some(_), _]) => format!("{part}: only the first log has it\n"),
            (None, _) => format!("{part}: only the second log has it\n"),
            (Some(place), values) => {
                let [a, b] = values.each_ref().map(|value| value.as_deref().unwrap_or("absent"));
                format!("{part}: {place} is {a} and {b}\n")
            }
        };
    }
    text += match (comparison.differs(), comparison.is_damaged()) {
        (true, _) => "the logs differ\n",
        (false, true) => "what is readable of both logs does not differ; the rest could not be compared\n",
        (false, false) => "the logs are equal, except for wall-clock times\n",
    };
    text
}

fn channel_text(channel: &ChannelComparison) -> String {
    let note = if channel.wall_clock { " (wall-clock times: not counted)" } else { "" };
    let topic = &channel.topic;
    match (&channel.messages, &channel.first) {
        ([Some(count), None], _) => {
            format!("{topic}: only the first log has it, with {count} messages{note}\n")
        }
        ([None, Some(count)], _) => {
            format!("{topic}: only the second log has it, with {count} messages{note}\n")
        }
        ([Some(a), Some(b)], None) if channel.lengths_differ => {
            format!("{topic}: {a} messages and {b} messages; those that both logs have are equal{note}\n")
        }
        (_, None) => {
            let compared = channel.messages.iter().flatten().min().copied().unwrap_or(0);
            format!("{topic}: {compared} messages are equal\n")
        }
        (_, Some(first)) => {
            let [a, b] = first.values.each_ref().map(|value| value.as_deref().unwrap_or("absent"));
            format!(
                "{topic}: differs first in message {} ({:.6} s): {} is {a} and {b}{note}\n",
                first.message,
                first.time_ns as f64 * 1e-9,
                first.field,
            )
        }
    }
}

fn diff_json(paths: [&Path; 2], comparison: &LogComparison) -> Value {
    let channel = |channel: &ChannelComparison| {
        json!({
            "topic": channel.topic,
            "messages": channel.messages,
            "wall_clock": channel.wall_clock,
            "differs": channel.differs(),
            "first_difference": channel.first.as_ref().map(|first| json!({
                "message": first.message,
                "time_s": first.time_ns as f64 * 1e-9,
                "field": first.field,
                "values": first.values,
            })),
        })
    };
    let part =
        |part: &PartDifference| json!({ "part": part.part, "place": part.place, "values": part.values });
    json!({
        "schema": "opspace.log-diff/1",
        "logs": paths,
        "differs": comparison.differs(),
        "damage": comparison.damage.each_ref().map(|damage| damage.as_ref().map(ToString::to_string)),
        "channels": comparison.channels.iter().map(channel).collect::<Vec<_>>(),
        "parts": comparison.parts.iter().map(part).collect::<Vec<_>>(),
    })
}
