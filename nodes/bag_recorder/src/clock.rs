//! The time of a bag's messages: the wall clock's when the recorder starts, and what has passed since. A wall clock that is set
//! meanwhile (a leap, a time server, a hand) neither turns their order round nor tears a hole into them.

use std::time::{Instant, SystemTime};

/// A clock that is set once.
#[derive(Clone, Copy)]
pub(crate) struct Clock {
    /// ns since 1970 at `set`.
    start: u64,
    set: Instant,
}

impl Clock {
    /// Sets it.
    pub(crate) fn set(wall: SystemTime, now: Instant) -> Self {
        let since = wall.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self { start: since.as_nanos() as u64, set: now }
    }

    /// ns since 1970.
    pub(crate) fn at(&self, now: Instant) -> u64 {
        self.start + now.saturating_duration_since(self.set).as_nanos() as u64
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn counts_on_from_the_wall_clock() {
        let now = Instant::now();
        let wall = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
        let clock = Clock::set(wall, now);
        assert_eq!(clock.at(now), 1_700_000_000_000_000_000);
        assert_eq!(clock.at(now + Duration::from_nanos(17)), 1_700_000_000_000_000_017);
        // A wall clock before 1970 is none.
        let lost = Clock::set(SystemTime::UNIX_EPOCH - Duration::from_secs(5), now);
        assert_eq!(lost.at(now), 0);
    }
}
