//! The hand: who holds it, and which force it is on each robot.

use crate::requests::{Grasp, HandMessage};
use nalgebra::Vector3;
use opspace_model::{FrameId, Model};
use opspace_sim::{ExternalForce, Pull};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time without a message after which the hand lets go.
pub(crate) const SILENCE: Duration = Duration::from_millis(50);

/// The hand of a view. Its lock is held only while a few numbers are copied.
#[derive(Debug, Default)]
pub(crate) struct Hand(Mutex<Option<Held>>);

/// Grasp of a connection.
#[derive(Clone, Debug)]
struct Held {
    connection: u64,
    at: Instant,
    grasp: Grasp,
    /// Frame on each robot; `None` for one that cannot be pushed, or lacks the link.
    frames: Vec<Option<FrameId>>,
}

/// Name of a robot, and its model if it can be pushed.
pub(crate) type Pushable<'a> = (&'a str, Option<&'a Model>);

impl Hand {
    /// Moves the hand of a connection, at `now`.
    ///
    /// # Errors
    /// A link that no robot has, or not the named one, or a hand that another page holds, with a description.
    pub fn receive<'a>(
        &self,
        connection: u64,
        message: HandMessage,
        robots: impl Iterator<Item = Pushable<'a>>,
        now: Instant,
    ) -> Result<(), String> {
        let grasp = match message {
            HandMessage::Release => {
                self.release(connection);
                return Ok(());
            }
            HandMessage::Hold(grasp) => grasp,
        };
        let is_meant = |name: &str| grasp.robot.as_ref().is_none_or(|robot| robot == name);
        let frame =
            |(name, model): Pushable<'_>| model.filter(|_| is_meant(name))?.frame_id(&grasp.frame).ok();
        let frames: Vec<_> = robots.map(frame).collect();
        if frames.iter().all(Option::is_none) {
            let robot = grasp.robot.map_or_else(String::new, |robot| format!(" '{robot}'"));
            return Err(format!("/hand: no robot{robot} that can be pushed has a link '{}'", grasp.frame));
        }
        let mut held = self.lock();
        let other = held.as_ref().filter(|held| held.connection != connection && !is_silent(held, now));
        if other.is_some() {
            return Err("/hand: another page holds it".to_owned());
        }
        *held = Some(Held { connection, at: now, grasp, frames });
        Ok(())
    }

    /// Lets go, if this connection holds it.
    pub fn release(&self, connection: u64) {
        let mut held = self.lock();
        if held.as_ref().is_some_and(|held| held.connection == connection) {
            *held = None;
        }
    }

    /// Calls `set` with the force on each of the robots that can be pushed: none if the hand is released or silent at `now`. Calls it
    /// not at all if the lock is taken, so that the caller never waits.
    pub fn apply(&self, robots: usize, now: Instant, set: &mut dyn FnMut(usize, Option<ExternalForce>)) {
        let Ok(mut held) = self.0.try_lock() else { return };
        if held.as_ref().is_some_and(|held| is_silent(held, now)) {
            *held = None;
        }
        for robot in 0..robots {
            let frame = held.as_ref().and_then(|held| *held.frames.get(robot)?);
            set(robot, frame.zip(held.as_ref()).map(|(frame, held)| force(frame, &held.grasp)));
        }
    }

    /// Grasp at `now`, if there is one, and whether it acts on each of the robots.
    pub fn grasp(&self, now: Instant) -> Option<(Grasp, Vec<bool>)> {
        let held = self.lock();
        let held = held.as_ref().filter(|held| !is_silent(held, now))?;
        Some((held.grasp.clone(), held.frames.iter().map(Option::is_some).collect()))
    }

    fn lock(&self) -> MutexGuard<'_, Option<Held>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn is_silent(held: &Held, now: Instant) -> bool {
    now.saturating_duration_since(held.at) > SILENCE
}

fn force(frame: FrameId, grasp: &Grasp) -> ExternalForce {
    let pull = Pull::Drag {
        point_m: Vector3::from(grasp.point_m),
        target_m: Vector3::from(grasp.target_m),
        stiffness_n_per_m: grasp.stiffness_n_per_m,
        damping_ns_per_m: grasp.damping_ns_per_m,
        largest_force_n: grasp.largest_force_n,
    };
    ExternalForce { frame, pull }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

    const URDF: &str = r#"<robot name="arm"><link name="base"/><joint name="hinge" type="continuous">
        <parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
        <link name="rod"><inertial><mass value="2"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
        </robot>"#;

    fn hold(frame: &str) -> HandMessage {
        let zero = [0.0; 3];
        HandMessage::Hold(Grasp {
            frame: frame.to_owned(),
            point_m: zero,
            target_m: zero,
            ..Grasp::default()
        })
    }

    /// The hand acts on the robots that can be pushed and have the link, until it is released, lost or silent.
    #[test]
    fn hand_is_released_by_its_page_or_its_silence() {
        let model = Model::from_urdf(URDF).unwrap().model;
        let (hand, begin) = (Hand::default(), Instant::now());
        let robots = || [("pushed", Some(&model)), ("real", None)].into_iter();
        let is_held = |now| {
            let mut forces = Vec::new();
            hand.apply(2, now, &mut |_, force| forces.push(force.is_some()));
            forces
        };
        assert_eq!(is_held(begin), [false, false]);
        assert!(hand.receive(1, hold("hand"), robots(), begin).is_err());
        hand.receive(1, hold("rod"), robots(), begin).unwrap();
        assert_eq!(is_held(begin + SILENCE), [true, false]);
        assert!(hand.receive(2, hold("rod"), robots(), begin).is_err());
        hand.release(2);
        assert!(hand.grasp(begin).is_some());
        hand.release(1);
        assert_eq!(is_held(begin), [false, false]);
        hand.receive(1, hold("rod"), robots(), begin).unwrap();
        let late = begin + SILENCE + Duration::from_millis(1);
        assert_eq!(is_held(late), [false, false]);
        hand.receive(1, hold("rod"), robots(), begin).unwrap();
        hand.receive(2, hold("rod"), robots(), late).unwrap();
        assert_eq!(is_held(late), [true, false]);
    }

    /// A grasp that names a robot pulls that one alone; without a name it pulls all that have the link.
    #[test]
    fn hand_pulls_the_named_robot_alone() {
        let model = Model::from_urdf(URDF).unwrap().model;
        let (hand, now) = (Hand::default(), Instant::now());
        let robots = || ["leader", "follower"].map(|name| (name, Some(&model))).into_iter();
        let pulled = |robot: Option<&str>| {
            let HandMessage::Hold(grasp) = hold("rod") else { panic!() };
            let grasp = Grasp { robot: robot.map(str::to_owned), ..grasp };
            hand.receive(1, HandMessage::Hold(grasp), robots(), now).map(|()| hand.grasp(now).unwrap().1)
        };
        assert_eq!(pulled(None), Ok(vec![true, true]));
        assert_eq!(pulled(Some("follower")), Ok(vec![false, true]));
        assert!(pulled(Some("another")).unwrap_err().contains("'another'"));
    }
}
