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

/// Arm of a robot: a chain of joints that branches off from the others.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Arm {
    /// Link that holds its first joint.
    pub from: String,
    /// Its last link, without fingers.
    pub to: String,
    /// Number of its joints.
    pub joints: usize,
}

/// Returns the arms of a robot: chains of at least three joints, each from the link where it branches off, or from the base, to
/// its end or to the hand that it holds. One chain without a branch is one arm.
#[must_use]
pub fn arms(model: &Model) -> Vec<Arm> {
    let bodies = model.bodies();
    let children = |body: usize| (0..bodies.len()).filter(move |&child| bodies[child].parent == Some(body));
    let mut arms = Vec::new();
    let mut starts: Vec<usize> = (0..bodies.len()).filter(|&body| bodies[body].parent.is_none()).collect();
    while let Some(first) = starts.pop() {
        let (mut last, mut joints) = (first, 1);
        while let [next] = children(last).collect::<Vec<_>>()[..]
            && (joints < LEAST_ARM_JOINTS || !is_finger(model, next))
        {
            (last, joints) = (next, joints + 1);
        }
        let below: Vec<usize> = children(last).collect();
        let is_hand = joints >= LEAST_ARM_JOINTS && below.iter().all(|&body| depth(model, body) <= joints);
        if is_hand {
            let from = bodies[first].parent;
            let link = |body: Option<usize>| model.frames().iter().find(|frame| frame.body == body);
            let to = last_frame(model, last).map(|frame| model.frame(frame).name.clone());
            if let (Some(from), Some(to)) = (link(from), to) {
                arms.push(Arm { from: from.name.clone(), to, joints });
            }
        } else {
            starts.extend(below);
        }
    }
    arms.reverse();
    arms
}

/// Number of joints of the longest chain that begins with a body.
fn depth(model: &Model, body: usize) -> usize {
    let bodies = model.bodies();
    let below = (0..bodies.len()).filter(|&child| bodies[child].parent == Some(body));
    1 + below.map(|child| depth(model, child)).max().unwrap_or(0)
}

/// True if the joint of a body is that of a finger, by its name.
fn is_finger(model: &Model, body: usize) -> bool {
    let name = model.joints()[model.bodies()[body].joint].name.to_lowercase();
    FINGERS.iter().any(|part| name.contains(part))
}

/// Words of the names that people give the end of an arm, the most telling first.
const ENDS: [&str; 9] = ["tool0", "tcp", "end_effector", "ee", "eef", "grasp", "flange", "tool", "tip"];

/// Words of the names of what is fixed to the end of an arm without being it: fiducials and sensors.
const NO_ENDS: [&str; 13] = [
    "aruco", "marker", "fiducial", "camera", "optical", "sensor", "range", "laser", "imu", "ft", "force",
    "light", "led",
];

/// Frame that is the tool of a body: one whose name says so, or else the last one that is no fiducial or sensor.
fn last_frame(model: &Model, body: usize) -> Option<FrameId> {
    let frames =
        || model.frames().iter().filter(|frame| frame.body == Some(body)).map(|frame| frame.name.as_str());
    let ends = || frames().filter(|name| !is_no_end(name));
    let named = |word: &&str| ends().find(|name| has_word(name, word));
    let name = ENDS.iter().find_map(named).or_else(|| ends().next_back()).or_else(|| frames().next_back())?;
    model.frame_id(name).ok()
}

/// Names of the other links that are fixed to the end of an arm at another place than its tip, and could be meant.
#[must_use]
pub fn other_ends(model: &Model, tip: FrameId) -> Vec<&str> {
    let chosen = model.frame(tip);
    let is_other = |frame: &&opspace_model::Frame| {
        let apart_m = (frame.placement.translation - chosen.placement.translation).norm();
        frame.body == chosen.body && frame.name != chosen.name && apart_m > 1e-6 && !is_no_end(&frame.name)
    };
    // The first frame of a body is that of its joint.
    let first =
        model.frames().iter().find(|frame| frame.body == chosen.body).map(|frame| frame.name.as_str());
    let others = model.frames().iter().filter(is_other).map(|frame| frame.name.as_str());
    others.filter(|name| Some(*name) != first).collect()
}

fn is_no_end(name: &str) -> bool {
    NO_ENDS.iter().any(|word| has_word(name, word))
}

/// True if a name has this word, or these words, between its underscores, hyphens and changes from small letters to capitals.
fn has_word(name: &str, word: &str) -> bool {
    let mut split = String::from("_");
    let mut was_lower = false;
    for c in name.chars() {
        if c.is_uppercase() && was_lower {
            split.push('_');
        }
        was_lower = c.is_lowercase();
        split.extend(if c.is_alphanumeric() { c.to_lowercase().next() } else { Some('_') });
    }
    split.push('_');
    split.contains(&format!("_{word}_"))
}

#[cfg(test)]
mod tests {
    use super::{arms, has_word};
    use opspace_model::Model;

    /// Checks a torso with two arms of four joints, one with a gripper of two fingers, and one arm alone.
    #[test]
    fn each_chain_of_a_robot_is_an_arm() {
        let link = |name: &str| {
            format!(
                "<link name=\"{name}\"><inertial><mass value=\"1\"/><inertia ixx=\"0.1\" iyy=\"0.1\" izz=\"0.1\" ixy=\"0\" \
                 ixz=\"0\" iyz=\"0\"/></inertial></link>"
            )
        };
        let joint = |parent: &str, child: &str| {
            format!(
                "<joint name=\"to_{child}\" type=\"revolute\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
                 <axis xyz=\"0 1 0\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>{}",
                link(child)
            )
        };
        let chain = |side: &str, from: &str| -> String {
            let names: Vec<String> = (1..=4).map(|number| format!("{side}{number}")).collect();
            let parents = std::iter::once(from).chain(names.iter().map(String::as_str));
            parents.zip(&names).map(|(parent, child)| joint(parent, child)).collect()
        };
        let hand = joint("left4", "finger_a") + &joint("left4", "finger_b");
        let head = "<robot name=\"r\"><link name=\"base\"/>".to_owned();
        let two = head.clone()
            + &joint("base", "torso")
            + &chain("left", "torso")
            + &hand
            + &chain("right", "torso")
            + "</robot>";
        let found = arms(&Model::from_urdf(&two).expect("a URDF").model);
        let mut found: Vec<(&str, &str, usize)> =
            found.iter().map(|arm| (arm.from.as_str(), arm.to.as_str(), arm.joints)).collect();
        found.sort_unstable();
        assert_eq!(found, [("torso", "left4", 4), ("torso", "right4", 4)]);
        let one = head + &chain("only", "base") + "</robot>";
        assert_eq!(arms(&Model::from_urdf(&one).expect("a URDF").model).len(), 1);
    }

    #[test]
    fn words_are_between_underscores_and_capitals() {
        for (name, word, has) in [
            ("tool0", "tool0", true),
            ("left_ee_link", "ee", true),
            ("wheel", "ee", false),
            ("endEffector", "end_effector", true),
            ("linkArucoFingertip", "aruco", true),
            ("lift", "ft", false),
            ("wrist_left_ft_link", "ft", true),
        ] {
            assert_eq!(has_word(name, word), has, "{name} {word}");
        }
    }
}
