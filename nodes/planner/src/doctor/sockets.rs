//! The buffers that the system gives to sockets, against what the stack has under way at once.

use patchmill_node_runtime::topics::nodes;
use patchmill_products::wire::MAX_CHUNK_BYTES;

use super::Finding;

const CHECK: &str = "socket buffers";
/// What a sender has under way on a topic before it waits for its readers: one chunk ([`patchmill_node_runtime::qos::CHUNK_WINDOW`]),
/// of which Linux counts about the double, for the overhead of its packets.
const CHUNK: usize = 2 * MAX_CHUNK_BYTES;
/// As much as all stages together may have under way, the last of which has three products: with that no burst overruns a socket.
const WANTED: usize = CHUNK * (nodes::STAGES.len() + 2);
/// What rustdds asks for; more is of no use.
const ASKED: usize = 8 << 20;

/// Largest buffers that a socket may have, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Buffers {
    /// For receiving: `net.core.rmem_max`.
    pub receive: usize,
    /// For sending: `net.core.wmem_max`.
    pub send: usize,
}

/// What this system allows.
pub fn sockets() -> Finding {
    let limit = |name: &str| {
        let file = format!("/proc/sys/net/core/{name}");
        let text = std::fs::read_to_string(&file).map_err(|e| format!("{file}: {e}"))?;
        text.trim().parse::<usize>().map_err(|_| format!("{file}: `{}` is no number", text.trim()))
    };
    match limit("rmem_max").and_then(|receive| Ok(Buffers { receive, send: limit("wmem_max")? })) {
        Ok(buffers) => judged(buffers),
        Err(what) => Finding::doubtful(CHECK, what, "look at net.core.rmem_max and wmem_max by hand"),
    }
}

fn judged(Buffers { receive, send }: Buffers) -> Finding {
    let kib = |bytes: usize| bytes / 1024;
    let found = format!(
        "net.core.rmem_max {} KiB, wmem_max {} KiB; {} KiB hold all that is under way at once, {} KiB one chunk",
        kib(receive),
        kib(send),
        kib(WANTED),
        kib(CHUNK)
    );
    let advice = |effect: &str| {
        format!(
            "{effect}; as root: sysctl -w net.core.rmem_max={ASKED} net.core.wmem_max={ASKED} (to keep it: /etc/sysctl.d/60-patchmill.conf)"
        )
    };
    match receive.min(send) {
        least if least < CHUNK => {
            Finding::bad(CHECK, found, advice("large products will not come through on their topics"))
        }
        least if least < WANTED => {
            Finding::doubtful(CHECK, found, advice("bursts are dropped and sent again: slower, not wrong"))
        }
        _ => Finding::good(CHECK, found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::Mood;

    #[test]
    fn the_smaller_buffer_decides() {
        let state = |receive: usize, send: usize| judged(Buffers { receive, send }).state;
        assert_eq!(state(ASKED, ASKED), Mood::Good);
        assert_eq!((state(ASKED, 212_992), state(212_992, ASKED)), (Mood::Doubtful, Mood::Doubtful));
        assert_eq!(state(65_536, ASKED), Mood::Bad);
        assert!(judged(Buffers { receive: 1, send: 1 }).advice.contains("net.core.rmem_max=8388608"));
    }
}
