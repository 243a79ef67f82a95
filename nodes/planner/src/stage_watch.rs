//! Which stages are alive, by their signs of life. Pure: the caller brings the time.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A stage that has given no sign of life (one every half second) for so long is gone.
pub const SILENCE: Duration = Duration::from_secs(4);

/// Two processes that started within so many seconds of each other cannot be told apart by age.
const TIE: f64 = 0.1;

/// What became of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// No sign of life for [`SILENCE`].
    Gone(String),
    /// The same process gives signs of life again.
    Back(String),
    /// A new process is there: what the old one held is lost.
    Restarted(String),
    /// A new process is there, and the old one too.
    Twice(String),
}

struct Life {
    /// When the process started, as it says; tells a new process from the old one. Empty before its first sign of life.
    started: String,
    /// For how long it had been running when it was heard last, s.
    up: f64,
    heard: Instant,
    gone: bool,
    /// An older one was heard beside it, and told of.
    twice: bool,
}

impl Life {
    fn of(started: &str, up: f64, now: Instant) -> Self {
        Self { started: started.to_owned(), up, heard: now, gone: false, twice: false }
    }

    /// For how long it has been running, s.
    fn up_at(&self, now: Instant) -> f64 {
        self.up + now.saturating_duration_since(self.heard).as_secs_f64()
    }
}

/// The signs of life of some stages; what others say of themselves does not count.
pub struct StageWatch {
    stages: &'static [&'static str],
    lives: BTreeMap<String, Life>,
}

impl StageWatch {
    /// Nothing heard of these stages.
    pub fn of(stages: &'static [&'static str]) -> Self {
        Self { stages, lives: BTreeMap::new() }
    }

    /// A first message of a stage, before its first sign of life. Later ones count for nothing.
    pub fn met(&mut self, stage: &str, now: Instant) {
        if self.stages.contains(&stage) {
            self.lives.entry(stage.to_owned()).or_insert_with(|| Life::of("", 0.0, now));
        }
    }

    /// A sign of life of a stage whose process started at `started` and has been running for `up` seconds.
    pub fn heard(&mut self, stage: &str, started: &str, up: f64, now: Instant) -> Option<Change> {
        if !self.stages.contains(&stage) {
            return None;
        }
        let Some(life) = self.lives.get_mut(stage) else {
            self.lives.insert(stage.to_owned(), Life::of(started, up, now));
            return None;
        };
        if life.started == started || life.started.is_empty() {
            let was_gone = life.gone && !life.started.is_empty();
            *life = Life { twice: life.twice, ..Life::of(started, up, now) };
            return was_gone.then(|| Change::Back(stage.to_owned()));
        }
        if up + TIE > life.up_at(now) && !life.gone {
            let told = std::mem::replace(&mut life.twice, true);
            return (!told).then(|| Change::Twice(stage.to_owned()));
        }
        *life = Life::of(started, up, now);
        Some(Change::Restarted(stage.to_owned()))
    }

    /// Stages that have fallen silent since the last call.
    pub fn fallen_silent(&mut self, now: Instant) -> Vec<Change> {
        let mut changes = Vec::new();
        for (stage, life) in &mut self.lives {
            if !life.gone && now.saturating_duration_since(life.heard) >= SILENCE {
                life.gone = true;
                changes.push(Change::Gone(stage.clone()));
            }
        }
        changes
    }

    /// Whether a stage is there.
    pub fn is_alive(&self, stage: &str, now: Instant) -> bool {
        self.lives.get(stage).is_some_and(|l| now.saturating_duration_since(l.heard) < SILENCE)
    }

    /// The stage that has been silent longest of those that are gone, and for how long.
    pub fn longest_gone(&self, now: Instant) -> Option<(&str, Duration)> {
        let gone = self.lives.iter().filter(|(_, life)| life.gone);
        gone.map(|(stage, life)| (stage.as_str(), now.saturating_duration_since(life.heard)))
            .max_by_key(|(_, silence)| *silence)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tells_silence_return_and_restart_apart() {
        let start = Instant::now();
        let at = |s: f64| start + Duration::from_secs_f64(s);
        let mut watch = StageWatch::of(&["a", "b", "c"]);
        assert!(!watch.is_alive("a", at(0.0)));
        assert_eq!(watch.heard("a", "1", 9.0, at(0.0)), None);
        assert_eq!(watch.heard("b", "1", 9.0, at(0.0)), None);
        assert_eq!(watch.heard("a", "1", 12.0, at(3.0)), None);
        assert_eq!(watch.fallen_silent(at(4.5)), [Change::Gone("b".to_owned())]);
        assert_eq!(watch.fallen_silent(at(4.6)), []);
        assert!(watch.is_alive("a", at(4.6)) && !watch.is_alive("b", at(4.6)));
        assert_eq!(watch.longest_gone(at(5.0)), Some(("b", Duration::from_secs(5))));
        assert_eq!(watch.heard("b", "1", 15.0, at(6.0)), Some(Change::Back("b".to_owned())));
        assert_eq!(watch.longest_gone(at(6.0)), None);
        // A quick restart shows without silence.
        assert_eq!(watch.heard("b", "2", 0.1, at(6.5)), Some(Change::Restarted("b".to_owned())));
        assert_eq!(watch.heard("b", "2", 0.6, at(7.0)), None);
        // Somebody else is not missed when he falls silent.
        watch.met("x", at(0.0));
        assert_eq!(watch.heard("y", "1", 9.0, at(0.0)), None);
        assert_eq!(watch.fallen_silent(at(10.9)), [Change::Gone("a".to_owned())]);
        // A message before the first sign of life says that the stage is there, not which process it is.
        watch.met("c", at(7.0));
        assert!(watch.is_alive("c", at(7.5)));
        assert_eq!(watch.heard("c", "1", 1.0, at(8.0)), None);
        watch.met("c", at(20.0));
        assert!(!watch.is_alive("c", at(20.0)));
    }

    #[test]
    fn an_old_process_beside_a_new_one_is_told_of_once() {
        let start = Instant::now();
        let at = |s: f64| start + Duration::from_secs_f64(s);
        let mut watch = StageWatch::of(&["a"]);
        assert_eq!(watch.heard("a", "old", 60.0, at(0.0)), None);
        assert_eq!(watch.heard("a", "new", 0.2, at(0.3)), Some(Change::Restarted("a".to_owned())));
        assert_eq!(watch.heard("a", "old", 60.5, at(0.5)), Some(Change::Twice("a".to_owned())));
        assert_eq!(watch.heard("a", "new", 0.7, at(0.8)), None);
        assert_eq!(watch.heard("a", "old", 61.0, at(1.0)), None);
        // The new one ends: the old one is the stage again.
        assert_eq!(watch.fallen_silent(at(5.0)), [Change::Gone("a".to_owned())]);
        assert_eq!(watch.heard("a", "old", 65.5, at(5.5)), Some(Change::Restarted("a".to_owned())));
        assert_eq!(watch.heard("a", "old", 66.0, at(6.0)), None);
    }
}
