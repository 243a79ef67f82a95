//! Whether multicast passes on the loopback, by sending there.

use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::time::Duration;

use super::Finding;

const CHECK: &str = "loopback";
/// The group of DDS discovery.
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);
/// For a datagram to this machine itself.
const PATIENCE: Duration = Duration::from_millis(500);

/// Sends a datagram to the group of discovery and listens for it.
pub fn multicast() -> Finding {
    match try_it() {
        Ok(()) => Finding::good(CHECK, "multicast passes on 127.0.0.1"),
        Err(e) => Finding::doubtful(
            CHECK,
            format!(
                "multicast to {GROUP} does not pass on 127.0.0.1 ({e}); patchmill's nodes find each other without it"
            ),
            "for other ROS nodes on this machine, as root: ip link set lo multicast on",
        ),
    }
}

fn try_it() -> io::Result<()> {
    // A port of its own: nobody else is disturbed.
    let receiver = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    receiver.join_multicast_v4(&GROUP, &Ipv4Addr::LOCALHOST)?;
    receiver.set_read_timeout(Some(PATIENCE))?;
    // Linux sends multicast by the interface of the address that the socket is bound to.
    let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    sender.set_multicast_loop_v4(true)?;
    let word = format!("patchmill doctor {}", std::process::id());
    sender.send_to(word.as_bytes(), (GROUP, receiver.local_addr()?.port()))?;
    let mut heard = [0; 64];
    loop {
        let (length, _) = receiver.recv_from(&mut heard)?;
        if heard.get(..length) == Some(word.as_bytes()) {
            return Ok(());
        }
    }
}
