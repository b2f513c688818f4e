//! Address of a live view, and the robots beside that of a run, on the command line.

use opspace_backend::CommandKind;
use opspace_experiment::ControllerKind;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, ToSocketAddrs};

/// Port of a view, that of Foxglove's live messages.
const PORT: u16 = 8765;

/// Address of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewAddress {
    /// Address.
    pub socket: SocketAddr,
    /// True if another port is as good, because none was asked for.
    pub any_port: bool,
}

impl Default for ViewAddress {
    fn default() -> Self {
        Self { socket: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), PORT), any_port: true }
    }
}

/// Parses a port, a host, or both; nothing is the default address.
pub fn view_address(text: &str) -> Result<ViewAddress, String> {
    let default = ViewAddress::default();
    if text.is_empty() {
        return Ok(default);
    }
    if let Ok(port) = text.parse::<u16>() {
        return Ok(ViewAddress { socket: SocketAddr::new(default.socket.ip(), port), any_port: false });
    }
    if let Ok(ip) = text.parse::<IpAddr>() {
        return Ok(ViewAddress { socket: SocketAddr::new(ip, PORT), any_port: true });
    }
    let found = text.to_socket_addrs().ok().and_then(|mut found| found.next());
    let socket = found.ok_or("expected a port, or HOST:PORT of this computer, for example 127.0.0.1:8765")?;
    Ok(ViewAddress { socket, any_port: false })
}

/// Robot beside that of a run: another interface, or inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// Interface.
    pub backend: CommandKind,
    /// Controller.
    pub controller: ControllerKind,
}

impl Side {
    /// Name of the robot in a view and in folders.
    pub fn name(self) -> &'static str {
        match self.controller {
            ControllerKind::Osc => self.backend.name(),
            other => other.name(),
        }
    }
}

/// Parses a robot beside that of a run.
pub fn side(text: &str) -> Result<Side, String> {
    let known = [
        Side { backend: CommandKind::Position, controller: ControllerKind::Osc },
        Side { backend: CommandKind::Velocity, controller: ControllerKind::Osc },
        Side { backend: CommandKind::Torque, controller: ControllerKind::Osc },
        Side { backend: CommandKind::Position, controller: ControllerKind::Ik },
        Side { backend: CommandKind::Position, controller: ControllerKind::IkLead },
    ];
    let found = known.into_iter().find(|side| side.name() == text);
    found.ok_or_else(|| format!("expected {}", known.map(Side::name).join(", ")))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "a test")]
    use super::*;

    /// Compared: texts and the addresses that they mean.
    #[test]
    fn addresses_are_read() {
        let socket = |text: &str| view_address(text).unwrap().socket.to_string();
        assert_eq!(socket(""), "127.0.0.1:8765");
        assert_eq!(socket("9000"), "127.0.0.1:9000");
        assert_eq!(socket("0.0.0.0"), "0.0.0.0:8765");
        assert_eq!(socket("0.0.0.0:80"), "0.0.0.0:80");
        assert_eq!(socket("::1"), "[::1]:8765");
        for bad in ["70000", "nowhere", "127.0.0.1:", ":"] {
            assert!(view_address(bad).is_err(), "{bad}");
        }
        assert_eq!(side("ik").unwrap().name(), "ik");
        assert!(side("spring").unwrap_err().contains("torque"));
    }
}
