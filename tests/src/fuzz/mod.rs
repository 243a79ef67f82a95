//! Every parser against mutated inputs: no panic, no input that takes longer than a second, no memory far beyond the input.
//!
//! Read top-down: [`run`] takes the inputs of a range one after the other through a [`Parser`] of [`parsers`](parsers::parsers);
//! input number n is made from the parser's seeds by [`mutate`] and depends on the run's seed and n alone, so that whatever is
//! found can be made again. Seeds are valid files and messages ([`seeds`], [`random_message`]) and hostile ones.

pub mod messages;
pub mod mutate;
pub mod parsers;
pub mod random_message;
pub mod run;
pub mod seeds;

/// Whether a parser takes an input.
pub type Parse = Box<dyn Fn(&[u8]) -> bool + Send + Sync>;

/// A parser with what it is fed.
pub struct Parser {
    /// What it is called on the command line; of messages their type.
    pub name: String,
    /// Inputs to start from.
    pub seeds: Vec<Vec<u8>>,
    /// Parses; whether the input was taken for valid.
    pub parse: Parse,
}

impl Parser {
    /// A parser by its parts.
    pub fn new(
        name: &str,
        seeds: Vec<Vec<u8>>,
        parse: impl Fn(&[u8]) -> bool + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.to_owned(), seeds, parse: Box::new(parse) }
    }
}
