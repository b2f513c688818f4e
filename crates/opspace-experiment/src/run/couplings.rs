//! Couplings between tasks of two robots of a scenario, and the channels between all robots.

use crate::codes::Code;
use crate::files::experiment_file::{ChannelFile, CouplingEnd, CouplingFile, ExperimentFile};
use crate::files::source::{FileError, Source};
use crate::run::member::Member;
use crate::suggest::choices;
use crate::text::format_short;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_backend::{Layout, Signal, TICK, signal_names};
use opspace_coupling::{CouplingKind, CouplingSide, Reflected, TeleoperationParameters};
use opspace_loop::{ChannelParameters, ControlLoop, Link, LinkError, Run, Timeline};

/// Distance of the seeds of scenarios with adjacent seeds, and the first seed of a channel within it.
pub(super) const SEEDS_OF_A_SCENARIO: u64 = 1000;
const FIRST_CHANNEL: u64 = 500;

/// Coupling between tasks of two robots.
#[derive(Clone, Debug)]
pub struct Coupling {
    /// Name of the coupling.
    pub name: String,
    /// Number and task of the leader.
    pub leader: (usize, String),
    /// Number and task of the follower.
    pub follower: (usize, String),
    /// The entry in the file.
    pub file: CouplingFile,
    channel: ChannelFile,
}

impl Coupling {
    /// Law of the coupling.
    #[must_use]
    pub fn kind(&self) -> CouplingKind {
        if self.file.carry.is_some() { CouplingKind::Carry } else { CouplingKind::Teleoperation }
    }

    /// Parameters of the teleoperation, if it is one.
    #[must_use]
    pub fn teleoperation(&self) -> Option<&TeleoperationParameters> {
        self.file.teleoperation.as_ref()
    }

    /// Name of the law in files.
    fn law_name(&self) -> &'static str {
        match self.kind() {
            CouplingKind::Carry => "carry",
            _ => "teleoperation",
        }
    }

    /// Key of the coupling in the file.
    fn key(&self) -> String {
        format!("couplings.{}", self.name)
    }

    /// Checks that both tasks have the same rows.
    pub(super) fn check_rows(&self, members: &[Member], source: &Source) -> Result<(), FileError> {
        let rows = [&self.leader, &self.follower].map(|(robot, task)| {
            let control = members[*robot].experiment.control_loop().ok()?;
            let name = signal_names::of(task, signal_names::PORT_POSITION);
            let signals = Run::layouts(&control, None).swap_remove(TICK).signals;
            signals.into_iter().find(|signal| signal.name == name)
        });
        let [Some(leader), Some(follower)] = rows else { return Ok(()) };
        if leader.units == follower.units {
            return Ok(());
        }
        let message = format!(
            "the two tasks have different rows: {} of the leader, {} of the follower",
            described(&leader),
            described(&follower)
        );
        let help = Some("couple the same number of axes or joints, in the same units".to_owned());
        Err(FileError::at_key(source, self.key(), message, help))
    }

    /// Refusals of the coupling.
    pub(super) fn refusals(&self, members: &[Member], source: &Source) -> Vec<FileError> {
        [self.late_packets(source), self.active_waves(members, source)].into_iter().flatten().collect()
    }

    /// Refusal of a channel whose packets arrive later than the receiver waits for them.
    fn late_packets(&self, source: &Source) -> Option<FileError> {
        let name = self.file.channel.as_ref()?;
        let ChannelFile { delay_s, jitter_s, hold_after_s, .. } = self.channel;
        let refuse = |key: &str, message: String, help: String| {
            let found = FileError::at_key(source, ["channels", name, key], message, Some(help));
            Some(found.refused(Code::LatePackets))
        };
        let (latest_s, hold_s) = (delay_s.get() + jitter_s.get(), hold_after_s.get());
        if latest_s >= hold_s {
            let message = format!(
                "delay_s + jitter_s is {} s, but a robot that hears nothing for {} s (hold_after_s) is held",
                format_short(latest_s),
                format_short(hold_s)
            );
            let help =
                format!("choose less than {} s in sum, or a larger hold_after_s", format_short(hold_s));
            return refuse("delay_s", message, help);
        }
        // The age of a packet counts from its arrival, so that a constant delay does not matter.
        let law = &self.file;
        let timeout_s = law.teleoperation.as_ref().map(|law| law.timeout_s);
        let timeout_s = timeout_s.or(law.carry.as_ref().map(|law| law.timeout_s)).map(Positive::get);
        if let Some(timeout_s) = timeout_s.filter(|timeout_s| jitter_s.get() >= *timeout_s) {
            let message = format!(
                "coupling '{}' opens {} s (timeout_s) after the last packet, but packets may arrive {} s apart",
                self.name,
                format_short(timeout_s),
                format_short(jitter_s.get())
            );
            let help = format!("choose less than {} s, or a larger timeout_s", format_short(timeout_s));
            return refuse("jitter_s", message, help);
        }
        None
    }

    /// Refusal of wave variables where they are not passive.
    fn active_waves(&self, members: &[Member], source: &Source) -> Option<FileError> {
        let reflects = self.teleoperation().map(|law| law.reflect);
        if !matches!(reflects, Some(Reflected::Waves { .. })) {
            return None;
        }
        let refuse = |message: String, help: &str| {
            let key = ["couplings", &self.name, "teleoperation", "reflect"];
            let found = FileError::at_key(source, key, message, Some(help.to_owned()));
            Some(found.refused(Code::ActiveWaves))
        };
        if self.channel.jitter_s != NonNegative::default() || self.channel.loss.get() != 0.0 {
            let message =
                "wave variables are passive with a constant delay only, but the channel has jitter or loss";
            return refuse(
                message.to_owned(),
                "choose another `reflect`, or a channel without jitter_s and loss",
            );
        }
        let rates = [self.leader.0, self.follower.0].map(|robot| members[robot].rate_hz);
        let (slower, faster) = (rates[0].min(rates[1]), rates[0].max(rates[1]));
        if faster % slower != 0 {
            let message = format!(
                "wave variables need equal rates, or one that is a multiple of the other; the leader has {} Hz, the follower {} Hz",
                rates[0], rates[1]
            );
            return refuse(message, "choose another `reflect`, or other profiles of the robots");
        }
        None
    }
}

/// Links in both directions between all robots: with the packets of a coupling between two that have one. `seed` is that of
/// the scenario in `source`.
pub(super) fn links(
    (source, seed): (&Source, u64),
    couplings: &[Coupling],
    timeline: &Timeline,
    loops: &[ControlLoop],
) -> Result<Vec<Link>, FileError> {
    let rows: Vec<Layout> =
        loops.iter().map(|control| Run::layouts(control, None).swap_remove(TICK)).collect();
    let mut links = Vec::new();
    let mistake = |key: &str, error: LinkError| FileError::at_key(source, key, error.to_string(), None);
    let mut seed = seed.wrapping_mul(SEEDS_OF_A_SCENARIO).wrapping_add(FIRST_CHANNEL);
    for coupling in couplings {
        for (from, to) in [(&coupling.leader, &coupling.follower), (&coupling.follower, &coupling.leader)] {
            let parameters = channel_parameters(&coupling.channel, seed);
            seed = seed.wrapping_add(1);
            let signals = coupling.kind().packet_signals().into_iter();
            let signals: Vec<(String, &str)> =
                signals.map(|(signal, input)| (signal_names::of(&from.1, signal), input)).collect();
            let copies: Vec<(&str, &str)> =
                signals.iter().map(|(signal, input)| (signal.as_str(), *input)).collect();
            let target = (to.0, &loops[to.0].targets(), to.1.as_str());
            let link = Link::new(timeline, (from.0, &rows[from.0]), target, &copies, parameters);
            links.push(link.map_err(|error| mistake(&coupling.key(), error))?);
        }
    }
    for (from, row) in rows.iter().enumerate() {
        for to in 0..loops.len() {
            let linked = links.iter().any(|link: &Link| link.from() == from && link.to() == to);
            if from != to && !linked {
                let parameters = channel_parameters(&ChannelFile::default(), seed);
                let link = Link::status(timeline, (from, row), to, parameters);
                links.push(link.map_err(|error| mistake("robots", error))?);
            }
        }
    }
    Ok(links)
}

fn described(signal: &Signal) -> String {
    let rows = signal.elements.iter().zip(&signal.units).map(|(row, unit)| format!("{row} ({unit})"));
    rows.collect::<Vec<_>>().join(", ")
}

fn channel_parameters(channel: &ChannelFile, seed: u64) -> ChannelParameters {
    ChannelParameters {
        delay_s: channel.delay_s.get(),
        jitter_s: channel.jitter_s.get(),
        loss: channel.loss.get(),
        reordering: channel.reordering,
        seed,
        hold_after_s: Some(channel.hold_after_s.get()),
    }
}

/// Resolves the couplings of a file.
pub(super) fn couplings(file: &ExperimentFile, source: &Source) -> Result<Vec<Coupling>, FileError> {
    let names: Vec<&str> = file.robots.keys().map(String::as_str).collect();
    let mut found: Vec<Coupling> = Vec::new();
    for (name, entry) in &file.couplings {
        let end = |end: &CouplingEnd, side: &str| {
            let number = names.iter().position(|known| *known == end.robot).ok_or_else(|| {
                let message = format!("there is no robot '{}'", end.robot);
                let key = ["couplings", name, side, "robot"];
                FileError::at_key(source, key, message, Some(choices(&end.robot, &names)))
            })?;
            Ok::<_, FileError>((number, end.task.clone()))
        };
        if entry.teleoperation.is_some() == entry.carry.is_some() {
            let help = Some("add `teleoperation = {}`, or `carry = { direction = [...] }`".to_owned());
            let message = "a coupling needs one law: `teleoperation` or `carry`";
            return Err(FileError::at_key(source, ["couplings", name], message, help));
        }
        let (leader, follower) = (end(&entry.leader, "leader")?, end(&entry.follower, "follower")?);
        if leader.0 == follower.0 {
            let key = ["couplings", name, "follower", "robot"];
            return Err(FileError::at_key(source, key, "a robot cannot be coupled with itself", None));
        }
        let is_taken = |end: &(usize, String)| found.iter().any(|c| c.leader == *end || c.follower == *end);
        if let Some((side, end)) =
            [("leader", &leader), ("follower", &follower)].into_iter().find(|(_, e)| is_taken(e))
        {
            let message = format!("task '{}' is already coupled", end.1);
            return Err(FileError::at_key(source, ["couplings", name, side, "task"], message, None));
        }
        let channel = match &entry.channel {
            None => ChannelFile::default(),
            Some(wanted) => *file.channels.get(wanted).ok_or_else(|| {
                let known: Vec<&str> = file.channels.keys().map(String::as_str).collect();
                let message = format!("there is no channel '{wanted}'");
                FileError::at_key(
                    source,
                    ["couplings", name, "channel"],
                    message,
                    Some(choices(wanted, &known)),
                )
            })?,
        };
        found.push(Coupling { name: name.clone(), leader, follower, file: entry.clone(), channel });
    }
    for (number, name) in names.iter().enumerate() {
        if !found.iter().any(|coupling| coupling.leader.0 == number || coupling.follower.0 == number) {
            let help = Some("add a coupling, or remove the robot".to_owned());
            let message = "this robot is not coupled with another one";
            return Err(FileError::at_key(source, ["robots", name], message, help));
        }
    }
    Ok(found)
}

/// Settings that write a coupling into the task of a robot, if it takes part in it.
pub(super) fn task_settings(source: &Source, coupling: &Coupling, robot: usize) -> Vec<String> {
    let sides = [(&coupling.leader, CouplingSide::Leader), (&coupling.follower, CouplingSide::Follower)];
    let Some(((_, task), side)) = sides.into_iter().find(|((number, _), _)| *number == robot) else {
        return Vec::new();
    };
    let side = match side {
        CouplingSide::Leader => "leader",
        CouplingSide::Follower => "follower",
    };
    let document: toml::Table = source.text().parse().unwrap_or_default();
    let law = document
        .get("couplings")
        .and_then(|couplings| couplings.get(&coupling.name)?.get(coupling.law_name()))
        .map_or_else(|| "{}".to_owned(), toml::Value::to_string);
    let name = coupling.law_name();
    vec![format!("task.{task}.coupled.side=\"{side}\""), format!("task.{task}.coupled.{name}={law}")]
}
