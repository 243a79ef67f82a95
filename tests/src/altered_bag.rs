//! Copies of a bag in which something is altered.

use std::path::Path;

use patchmill_bag_recorder::{BagMessage, BagReader, BagWriter, Topic};
use patchmill_msgs::{RosType, cdr, for_every_message};
use patchmill_node_runtime::Qos;

/// A topic of messages `T`.
pub fn topic_of<T: RosType>(name: &str, qos: Qos) -> Topic {
    Topic::of::<T>(name, qos)
}

/// A topic of messages of the type with that full name.
///
/// # Panics
/// When there is no such type.
fn topic_named(type_name: &str, name: &str) -> Topic {
    macro_rules! look {
        ($name:literal, $path:path, [$($constant:ident),*]) => {{
            type T = $path;
            if type_name == $name {
                return topic_of::<T>(name, Qos::Product);
            }
        }};
    }
    for_every_message!(look);
    panic!("there is no type {type_name}")
}

/// A message on its way into the copy.
pub struct Altered {
    message: BagMessage,
    /// Absolute name of its topic.
    pub topic: String,
}

impl Altered {
    /// The message, decoded.
    ///
    /// # Errors
    /// As [`BagMessage::decode`].
    pub fn decode<T: RosType>(&self) -> Result<T, patchmill_bag_recorder::BagError> {
        self.message.decode()
    }

    /// The same with another content.
    #[must_use]
    pub fn with<T: RosType>(self, content: &T) -> Self {
        Self { message: BagMessage { bytes: cdr::to_cdr(content), ..self.message }, ..self }
    }
}

/// A copy that is being written.
pub struct Copy {
    from: Vec<BagMessage>,
    to: BagWriter,
    describe: Box<dyn Fn(&mut Topic)>,
    last: u64,
}

impl Copy {
    /// A copy of a bag into a new folder.
    ///
    /// # Panics
    /// When one cannot be read or the other not be written.
    pub fn of(bag: &Path, into: &Path) -> Self {
        let read = BagReader::open(bag).and_then(|bag| bag.messages());
        match (read, BagWriter::create(into)) {
            (Ok(from), Ok(to)) => Self { from, to, describe: Box::new(|_| {}), last: 0 },
            (Err(e), _) | (_, Err(e)) => panic!("{e}"),
        }
    }

    /// Alters how topics are described.
    pub fn describe(&mut self, describe: impl Fn(&mut Topic) + 'static) {
        self.describe = Box::new(describe);
    }

    /// Copies every message, altered or left out.
    ///
    /// # Panics
    /// When the copy cannot be written.
    pub fn messages(&mut self, mut alter: impl FnMut(Altered) -> Option<Altered>) {
        for message in std::mem::take(&mut self.from) {
            let topic = message.topic.clone();
            let Some(Altered { message, .. }) = alter(Altered { message, topic }) else { continue };
            let mut topic = topic_named(&message.type_name, &message.topic);
            (self.describe)(&mut topic);
            self.last = message.time;
            if let Err(e) = self.to.write_bytes(&topic, message.time, &message.bytes) {
                panic!("{e}");
            }
        }
    }

    /// Adds a message.
    ///
    /// # Panics
    /// When the copy cannot be written.
    pub fn add<T: RosType>(&mut self, topic: &str, qos: Qos, message: &T) {
        if let Err(e) = self.to.write(&topic_of::<T>(topic, qos), self.last, message) {
            panic!("{e}");
        }
    }

    /// Ends the copy.
    ///
    /// # Panics
    /// When the copy cannot be written.
    pub fn finish(self) {
        if let Err(e) = self.to.finish() {
            panic!("{e}");
        }
    }
}
