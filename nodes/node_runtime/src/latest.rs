//! The newest input of a kind, joined by what it belongs to and never by order of arrival.

use std::sync::Arc;

/// Holds one value and the key it came with (a surface id, a [`crate::JobTag`]).
#[derive(Debug)]
pub struct Latest<K, T> {
    held: Option<(K, Arc<T>)>,
}

impl<K, T> Default for Latest<K, T> {
    fn default() -> Self {
        Self { held: None }
    }
}

impl<K: PartialEq, T> Latest<K, T> {
    /// Replaces what was held.
    pub fn put(&mut self, key: K, value: T) {
        self.held = Some((key, Arc::new(value)));
    }

    /// The value, if it belongs to `key`.
    pub fn of(&self, key: &K) -> Option<Arc<T>> {
        self.held.as_ref().filter(|(held, _)| held == key).map(|(_, value)| Arc::clone(value))
    }
}
