//! What a bag holds, as its metadata say it.

use std::collections::BTreeMap;

/// What a bag holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BagSummary {
    /// Time of the first message, ns since 1970; 0 without messages.
    pub start: u64,
    /// From the first to the last message, ns.
    pub duration: u64,
    /// Messages in all.
    pub message_count: u64,
    /// The topics by name.
    pub topics: Vec<TopicSummary>,
    /// The files in order.
    pub files: Vec<FileSummary>,
    /// Notes of the recorder, such as the number of dropped messages.
    pub notes: BTreeMap<String, String>,
}

/// What a bag or one of its files holds of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicSummary {
    /// Absolute name.
    pub name: String,
    /// Full name of its type.
    pub type_name: String,
    /// Type hash (RIHS01); empty when it is not known.
    pub type_hash: String,
    /// Offered quality of service (YAML).
    pub qos: String,
    /// Messages.
    pub message_count: u64,
}

/// One file of a bag.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FileSummary {
    /// Its name inside the bag's directory.
    pub name: String,
    /// Times of the first and the last message, ns since 1970; `None` without messages.
    pub times: Option<(u64, u64)>,
    /// Messages.
    pub message_count: u64,
    /// Its topics by name.
    pub topics: BTreeMap<String, TopicSummary>,
}

impl FileSummary {
    /// Of a file without messages.
    pub(crate) fn of(name: String) -> Self {
        Self { name, ..Self::default() }
    }

    /// Counts a message; `describe` gives its topic when it is the topic's first.
    pub(crate) fn count(&mut self, topic: &str, time: u64, describe: impl FnOnce() -> TopicSummary) {
        let (start, end) = self.times.unwrap_or((time, time));
        self.times = Some((start.min(time), end.max(time)));
        self.message_count += 1;
        match self.topics.get_mut(topic) {
            Some(known) => known.message_count += 1,
            None => {
                let described = TopicSummary { message_count: 1, ..describe() };
                self.topics.insert(topic.to_owned(), described);
            }
        }
    }
}

impl BagSummary {
    /// Of a bag's files in order.
    pub(crate) fn of(files: Vec<FileSummary>, notes: BTreeMap<String, String>) -> Self {
        let start = files.iter().filter_map(|f| f.times).map(|(start, _)| start).min().unwrap_or(0);
        let end = files.iter().filter_map(|f| f.times).map(|(_, end)| end).max().unwrap_or(0);
        let mut topics: BTreeMap<String, TopicSummary> = BTreeMap::new();
        for topic in files.iter().flat_map(|file| file.topics.values()) {
            let all = topics
                .entry(topic.name.clone())
                .or_insert_with(|| TopicSummary { message_count: 0, ..topic.clone() });
            all.message_count += topic.message_count;
        }
        Self {
            start,
            duration: end - start,
            message_count: files.iter().map(|f| f.message_count).sum(),
            topics: topics.into_values().collect(),
            files,
            notes,
        }
    }
}
