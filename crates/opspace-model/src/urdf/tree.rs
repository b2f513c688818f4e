//! Order of a robot's links, and the check that they form one tree.

use super::check::Description;
use super::error::{UrdfError, UrdfErrorKind};
use std::collections::HashMap;

/// Link with its parent joint and parent link.
pub(super) struct Step {
    /// Index of the link.
    pub link: usize,
    /// Indices of the parent joint and the parent link; `None` at the root.
    pub from: Option<(usize, usize)>,
}

/// Returns all links, depth first, parents before children; the children of a link are in the order of their joint
/// names.
pub(super) fn depth_first(description: &Description) -> Result<Vec<Step>, UrdfError> {
    let (links, joints) = (&description.links, &description.joints);
    let index: HashMap<&str, usize> = links.iter().enumerate().map(|(i, l)| (l.name.as_str(), i)).collect();
    // Parent joint and child joints of each link.
    let mut above: Vec<Option<usize>> = vec![None; links.len()];
    let mut below: Vec<Vec<usize>> = vec![Vec::new(); links.len()];
    let mut ends = Vec::with_capacity(joints.len());
    for (j, joint) in joints.iter().enumerate() {
        let find = |role: &'static str, name: &str| {
            index.get(name).copied().ok_or_else(|| {
                let known = links.iter().map(|l| l.name.clone()).collect();
                let kind = UrdfErrorKind::UnknownLink {
                    joint: joint.name.clone(),
                    role,
                    link: name.to_owned(),
                    known,
                };
                UrdfError::at(joint.line, kind)
            })
        };
        let (parent, child) = (find("parent", &joint.parent)?, find("child", &joint.child)?);
        if let Some(first) = above[child].replace(j) {
            let kind = UrdfErrorKind::TwoParents {
                link: joint.child.clone(),
                first: joints[first].name.clone(),
                second: joint.name.clone(),
            };
            return Err(UrdfError::at(joint.line, kind));
        }
        below[parent].push(j);
        ends.push((parent, child));
    }
    for children in &mut below {
        // In reverse order, because the stack returns the last entry first.
        children.sort_by(|&a, &b| joints[b].name.cmp(&joints[a].name));
    }

    let roots: Vec<usize> = (0..links.len()).filter(|&l| above[l].is_none()).collect();
    if let [_, second, ..] = roots[..] {
        let kind =
            UrdfErrorKind::SeveralRoots { links: roots.iter().map(|&l| links[l].name.clone()).collect() };
        return Err(UrdfError::at(links[second].line, kind));
    }
    let mut reached = vec![false; links.len()];
    let mut order = Vec::with_capacity(links.len());
    let mut stack: Vec<Step> = roots.iter().map(|&link| Step { link, from: None }).collect();
    while let Some(step) = stack.pop() {
        reached[step.link] = true;
        stack.extend(below[step.link].iter().map(|&j| Step { link: ends[j].1, from: Some((j, step.link)) }));
        order.push(step);
    }
    match reached.iter().position(|&r| !r) {
        None => Ok(order),
        // Each link has at most one parent, so a link that is not reached from the root is on a cycle or below one.
        Some(lost) => Err(cycle(description, &above, &ends, lost)),
    }
}

/// Returns the error for the cycle above `lost`, a link that is not reached from the root.
fn cycle(
    description: &Description,
    above: &[Option<usize>],
    ends: &[(usize, usize)],
    lost: usize,
) -> UrdfError {
    let up = |link: usize| above[link].map(|j| ends[j].0);
    // As many steps up as there are links end on the cycle.
    let on_cycle = (0..above.len()).fold(lost, |link, _| up(link).unwrap_or(link));
    let mut links = vec![on_cycle];
    let mut link = up(on_cycle);
    while let Some(next) = link.filter(|&l| l != on_cycle) {
        links.push(next);
        link = up(next);
    }
    links.push(on_cycle);
    links.reverse();
    let line = above[on_cycle].and_then(|j| description.joints[j].line);
    let links = links.iter().map(|&l| description.links[l].name.clone()).collect();
    UrdfError::at(line, UrdfErrorKind::Cycle { links })
}
