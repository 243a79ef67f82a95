//! Which stages are alive, by their signs of life. Pure: the caller brings the time.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// A stage that has given no sign of life (one every half second) for so long is gone.
pub const SILENCE: Duration = Duration::from_secs(4);

/// What became of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// No sign of life for [`SILENCE`].
    Gone(String),
    /// The same process gives signs of life again.
    Back(String),
    /// A new process is there: what the old one held is lost.
    Restarted(String),
}

struct Life {
    /// When the process started, as it says; tells a new process from the old one. Empty before its first sign of life.
    started: String,
    heard: Instant,
    gone: bool,
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
        let life = || Life { started: String::new(), heard: now, gone: false };
        if !self.stages.contains(&stage) {
            return;
        }
        self.lives.entry(stage.to_owned()).or_insert_with(life);
    }

    /// A sign of life of a stage whose process started at `started`.
    pub fn heard(&mut self, stage: &str, started: &str, now: Instant) -> Option<Change> {
        if !self.stages.contains(&stage) {
            return None;
        }
        let Some(life) = self.lives.get_mut(stage) else {
            let life = Life { started: started.to_owned(), heard: now, gone: false };
            self.lives.insert(stage.to_owned(), life);
            return None;
        };
        let was_gone = std::mem::replace(&mut life.gone, false);
        life.heard = now;
        if life.started != started {
            let first = life.started.is_empty();
            started.clone_into(&mut life.started);
            (!first).then(|| Change::Restarted(stage.to_owned()))
        } else {
            was_gone.then(|| Change::Back(stage.to_owned()))
        }
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
        assert_eq!(watch.heard("a", "1", at(0.0)), None);
        assert_eq!(watch.heard("b", "1", at(0.0)), None);
        assert_eq!(watch.heard("a", "1", at(3.0)), None);
        assert_eq!(watch.fallen_silent(at(4.5)), [Change::Gone("b".to_owned())]);
        assert_eq!(watch.fallen_silent(at(4.6)), []);
        assert!(watch.is_alive("a", at(4.6)) && !watch.is_alive("b", at(4.6)));
        assert_eq!(watch.longest_gone(at(5.0)), Some(("b", Duration::from_secs(5))));
        assert_eq!(watch.heard("b", "1", at(6.0)), Some(Change::Back("b".to_owned())));
        assert_eq!(watch.longest_gone(at(6.0)), None);
        // A quick restart shows without silence.
        assert_eq!(watch.heard("b", "2", at(6.5)), Some(Change::Restarted("b".to_owned())));
        assert_eq!(watch.heard("b", "2", at(7.0)), None);
        // Somebody else is not missed when he falls silent.
        watch.met("x", at(0.0));
        assert_eq!(watch.heard("y", "1", at(0.0)), None);
        assert_eq!(watch.fallen_silent(at(10.9)), [Change::Gone("a".to_owned())]);
        // A message before the first sign of life says that the stage is there, not which process it is.
        watch.met("c", at(7.0));
        assert!(watch.is_alive("c", at(7.5)));
        assert_eq!(watch.heard("c", "1", at(8.0)), None);
        watch.met("c", at(20.0));
        assert!(!watch.is_alive("c", at(20.0)));
    }
}
