//! Tip of a robot that names none.

use opspace_model::{FrameId, Model};

/// Least number of joints before a hand: the branches of a tree after fewer joints are arms, not fingers.
const LEAST_ARM_JOINTS: usize = 3;

/// Returns the frame at the end of the longest chain of joints, without the fingers of a hand; `None` if nothing moves.
#[must_use]
pub fn tip(model: &Model) -> Option<FrameId> {
    let parents: Vec<Option<usize>> = model.bodies().iter().map(|body| body.parent).collect();
    let chain = |leaf: usize| -> Vec<usize> {
        let mut bodies: Vec<usize> = std::iter::successors(Some(leaf), |&body| parents[body]).collect();
        bodies.reverse();
        bodies
    };
    // Of several longest chains, the one whose bodies come first.
    let longest = (0..parents.len()).map(chain).rev().max_by_key(Vec::len)?;
    let children = |body: usize| parents.iter().filter(|parent| **parent == Some(body)).count();
    let hand = (LEAST_ARM_JOINTS..longest.len())
        .find(|&joints| children(longest[joints - 1]) > 1 && longest.len() - joints <= joints);
    let body = longest[hand.unwrap_or(longest.len()) - 1];
    last_frame(model, body)
}

/// Frame that is the tool of a body: one whose name says so, or else the last one.
fn last_frame(model: &Model, body: usize) -> Option<FrameId> {
    let frames =
        || model.frames().iter().filter(|frame| frame.body == Some(body)).map(|frame| frame.name.as_str());
    let named = ["tool0", "tcp", "end_effector", "ee_link", "eef", "tool", "tip"];
    let name =
        named.iter().find_map(|word| frames().find(|name| name.contains(word))).or(frames().next_back())?;
    model.frame_id(name).ok()
}
