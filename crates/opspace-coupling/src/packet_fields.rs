//! Fields of a packet: each is a signal of the sender, which is copied to an input of the receiver.

use crate::received::Packet;
use nalgebra::Vector6;
use opspace_backend::signal_names::{
    PORT_CLOSED, PORT_ECHO, PORT_ENERGY_IN, PORT_FORCE, PORT_LIMITED, PORT_PARTNER_SESSION, PORT_POSITION,
    PORT_SEQUENCE, PORT_SESSION, PORT_TIME, PORT_VELOCITY,
};

/// Session of a sender that states none.
const UNSTATED_SESSION: f64 = 0.0;

/// Field with one value.
#[derive(Debug)]
pub(crate) struct NumberField {
    pub(crate) signal: &'static str,
    pub(crate) input: &'static str,
    pub(crate) unit: &'static str,
    /// True if a packet without it counts as lost.
    is_needed: bool,
    pub(crate) get: Get,
    set: Set,
}

/// Field with one value per row.
#[derive(Debug)]
pub(crate) struct RowField {
    pub(crate) signal: &'static str,
    pub(crate) input: &'static str,
    pub(crate) unit: RowUnit,
    pub(crate) of: fn(&mut Packet) -> &mut Vector6<f64>,
}

/// Units of the values of rows: those of each row, or one of all.
#[derive(Clone, Copy, Debug)]
pub(crate) enum RowUnit {
    Position,
    Velocity,
    Force,
    All(&'static str),
}

/// Fields with one value.
pub(crate) const NUMBERS: [NumberField; 8] = [
    needed(PORT_SEQUENCE, "sequence", "1", |p| p.sequence as f64, |p, x| p.sequence = x as u64),
    needed(PORT_TIME, "time_sent", "s", |p| p.sent_s, |p, x| p.sent_s = x),
    optional(PORT_ECHO, "echo", "s", |p| p.echo_s, |p, x| p.echo_s = x),
    needed(PORT_CLOSED, "closed", "1", |p| flag(p.closed), |p, x| p.closed = x == 1.0),
    optional(PORT_LIMITED, "limited", "1", |p| flag(p.limited), |p, x| p.limited = x == 1.0),
    needed(PORT_ENERGY_IN, "energy_in", "J", |p| p.energy_in_j, |p, x| p.energy_in_j = x),
    optional(PORT_SESSION, "session", "1", |p| p.session, |p, x| p.session = stated(x)),
    optional(
        PORT_PARTNER_SESSION,
        "partner_session",
        "1",
        |p| p.partner_session,
        |p, x| p.partner_session = x,
    ),
];

/// Fields with one value per row of each law, in the leader's coordinates. A law can have further ones.
pub(crate) const ROWS: [RowField; 3] = [
    RowField { signal: PORT_POSITION, input: "position", unit: RowUnit::Position, of: |p| &mut p.position },
    RowField { signal: PORT_VELOCITY, input: "velocity", unit: RowUnit::Velocity, of: |p| &mut p.velocity },
    RowField { signal: PORT_FORCE, input: "force", unit: RowUnit::Force, of: |p| &mut p.force },
];

type Get = fn(&Packet) -> f64;
type Set = fn(&mut Packet, f64);

/// Field without which a packet counts as lost.
const fn needed(
    signal: &'static str,
    input: &'static str,
    unit: &'static str,
    get: Get,
    set: Set,
) -> NumberField {
    NumberField { signal, input, unit, is_needed: true, get, set }
}

/// Field that can be NaN.
const fn optional(
    signal: &'static str,
    input: &'static str,
    unit: &'static str,
    get: Get,
    set: Set,
) -> NumberField {
    NumberField { is_needed: false, ..needed(signal, input, unit, get, set) }
}

fn flag(is_set: bool) -> f64 {
    f64::from(u8::from(is_set))
}

fn stated(session: f64) -> f64 {
    if session.is_finite() { session } else { UNSTATED_SESSION }
}

/// Packet without a value that the law needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Incomplete {
    pub(crate) session: f64,
    pub(crate) sequence: u64,
}

/// Reads the packet of `rows` rows from the values of the inputs, with the further fields that the law needs.
/// `Err` if it lacks a value that the law needs, `None` before the first packet.
pub(crate) fn packet(
    values: &[f64],
    rows: usize,
    further: &[RowField],
) -> Option<Result<Packet, Incomplete>> {
    let (numbers, vectors) = values.split_first_chunk::<{ NUMBERS.len() }>()?;
    let [sequence, .., session, _] = *numbers;
    // A task that has not started sends the number zero, and no session.
    let is_unstarted = session.is_nan() && sequence == 0.0;
    if !sequence.is_finite() || is_unstarted {
        return None;
    }
    let mut packet = Packet::default();
    let mut is_complete = true;
    for (field, &value) in NUMBERS.iter().zip(numbers) {
        is_complete &= value.is_finite() || !field.is_needed;
        (field.set)(&mut packet, value);
    }
    for (number, field) in ROWS.iter().chain(further).enumerate() {
        let values = vectors.get(number * rows..).and_then(|values| values.get(..rows)).unwrap_or(&[]);
        is_complete &= values.len() == rows && values.iter().all(|value| value.is_finite());
        (field.of)(&mut packet).as_mut_slice().iter_mut().zip(values).for_each(|(row, value)| *row = *value);
    }
    let Packet { session, sequence, .. } = packet;
    Some(if is_complete { Ok(packet) } else { Err(Incomplete { session, sequence }) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::teleoperation::FURTHER;

    /// Values of the inputs of a packet of two rows, with a wave.
    fn values(sequence: f64, wave: [f64; 2]) -> Vec<f64> {
        let scalars = [sequence, 0.1, f64::NAN, 1.0, 0.0, 0.5, f64::NAN, f64::NAN];
        let vectors = [[0.01, 0.02], [0.1, 0.2], [1.0, 2.0], wave];
        scalars.into_iter().chain(vectors.concat()).collect()
    }

    /// Compared: what is read of a packet without a wave by laws with and without waves, and the packets that count as lost.
    #[test]
    fn wave_is_needed_by_wave_variables_only() {
        let without = values(7.0, [f64::NAN; 2]);
        let read = packet(&without, 2, &[]).and_then(Result::ok).expect("is accepted");
        assert_eq!((read.sequence, read.wave), (7, Vector6::zeros()));
        assert_eq!(read.position, Vector6::new(0.01, 0.02, 0.0, 0.0, 0.0, 0.0));
        assert_eq!(packet(&without, 2, &FURTHER), Some(Err(Incomplete { session: 0.0, sequence: 7 })));
        let complete =
            packet(&values(8.0, [3.0, 4.0]), 2, &FURTHER).and_then(Result::ok).expect("is accepted");
        assert_eq!(complete.wave, Vector6::new(3.0, 4.0, 0.0, 0.0, 0.0, 0.0));
        assert_eq!(packet(&values(f64::NAN, [f64::NAN; 2]), 2, &[]), None);
    }
}
