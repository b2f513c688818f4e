//! Tip of a robot that names none.

use opspace_model::{FrameId, Model};

/// Least number of joints before a hand: the branches of a tree after fewer joints are arms, not fingers.
const LEAST_ARM_JOINTS: usize = 3;

/// Parts of the names of joints and links that only fingers have.
const FINGERS: [&str; 6] = ["finger", "gripper", "jaw", "thumb", "knuckle", "claw"];

/// Returns the frame at the end of the longest chain of joints, without the fingers of a hand: those that branch, and the last
/// joint of the chain if its name is that of a gripper. `None` if nothing moves.
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
    let mut joints = hand.unwrap_or(longest.len());
    while joints > LEAST_ARM_JOINTS && is_finger(model, longest[joints - 1]) {
        joints -= 1;
    }
    last_frame(model, longest[joints - 1])
}

/// Returns the names of the joints beyond a frame: those that move the links after it, but not the frame.
#[must_use]
pub fn joints_beyond(model: &Model, frame: FrameId) -> Vec<&str> {
    let moves: Vec<usize> = model.ancestors(frame).map(|body| model.bodies()[body].joint).collect();
    let end = model.ancestors(frame).next();
    let is_beyond = |body: usize| {
        let mut before = std::iter::successors(Some(body), |&body| model.bodies()[body].parent);
        end.is_some() && before.any(|body| Some(body) == end)
    };
    let beyond: Vec<usize> = (0..model.bodies().len()).filter(|&body| is_beyond(body)).collect();
    let joints = model.joints().iter().enumerate();
    joints
        .filter(|(joint, _)| {
            !moves.contains(joint) && beyond.iter().any(|&body| model.bodies()[body].joint == *joint)
        })
        .map(|(_, joint)| joint.name.as_str())
        .collect()
}

/// True if the joint of a body is that of a finger, by its name.
fn is_finger(model: &Model, body: usize) -> bool {
    let name = model.joints()[model.bodies()[body].joint].name.to_lowercase();
    FINGERS.iter().any(|part| name.contains(part))
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
