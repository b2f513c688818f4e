//! Changes of the bytes of a file: flips, cuts, insertions, zeroes and copies.

use opspace_testing::random::Random;

/// Longest part that is inserted, zeroed or copied, bytes.
const LONGEST: usize = 20_000;

/// Returns a file after a change of its bytes, rarely after two.
pub fn changed(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let once = change(bytes, random);
    if random.is(0.2) { change(&once, random) } else { once }
}

fn change(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    if bytes.is_empty() {
        return bytes;
    }
    let at = random.below(bytes.len());
    let most = [1, 16, 1000, LONGEST][random.below(4)];
    let length = 1 + random.below(most);
    let end = (at + length).min(bytes.len());
    match random.below(7) {
        0 | 1 => bytes[at] ^= 1 << random.below(8),
        2 => bytes.truncate(at),
        3 => drop(bytes.splice(at..at, (0..length).map(|k| (k * 37 + length) as u8))),
        4 => bytes[at..end].fill(0),
        5 => {
            let copy = bytes[at..end].to_vec();
            let to = random.below(bytes.len());
            bytes.splice(to..to, copy);
        }
        _ => drop(bytes.drain(at..end)),
    }
    bytes
}
