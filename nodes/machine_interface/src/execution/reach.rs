//! Which controllers a goal may name: the simulated machine, those that listen on this machine, and those that the node's parameter
//! `controllers` names. A goal may come from anybody on the domain, and a connection out of this machine is not theirs to open.

use std::net::IpAddr;

use super::BAD_CONTROLLER;
use crate::linuxcnc::client::host_and_port;
use patchmill_products::stage::StageError;

/// The controllers of other machines that may be connected to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reach {
    /// All.
    Any,
    /// `HOST:PORT`, in small letters.
    These(Vec<String>),
}

impl Reach {
    /// Reads `controllers`: empty (none), `any`, or `HOST:PORT` with commas or blanks between them.
    ///
    /// # Errors
    /// One sentence that names the word that is none of these.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.trim() == "any" {
            return Ok(Self::Any);
        }
        let words = text.split([',', ' ', '\t', '\n']).filter(|word| !word.is_empty());
        let address = |word: &str| match host_and_port(word) {
            Some(_) => Ok(word.to_ascii_lowercase()),
            None => Err(format!("`{word}`: nothing, `any` or HOST:PORT of controllers was expected")),
        };
        Ok(Self::These(words.map(address).collect::<Result<_, _>>()?))
    }

    /// Whether a goal may name the controller at `HOST:PORT`.
    ///
    /// # Errors
    /// [`BAD_CONTROLLER`].
    pub fn check(&self, address: &str) -> Result<(), StageError> {
        let named = match self {
            Self::Any => true,
            Self::These(addresses) => addresses.contains(&address.to_ascii_lowercase()),
        };
        if named || host_and_port(address).is_some_and(|(host, _)| is_here(host)) {
            return Ok(());
        }
        let text = format!(
            "{address} is not on this machine, and the parameter `controllers` of the node names neither it nor `any`"
        );
        Err(StageError::new(BAD_CONTROLLER, text))
    }
}

/// Whether a host is this machine by its name alone: what others resolve to is not asked.
fn is_here(host: &str) -> bool {
    let bare = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    host.eq_ignore_ascii_case("localhost")
        || bare.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_machine_and_what_was_named_may_be_reached() {
        let (none, any) = (Reach::parse(" ").unwrap(), Reach::parse("any").unwrap());
        let two = Reach::parse("Mill-2:5007,\n10.0.0.5:5008 ").unwrap();
        for here in
            ["127.0.0.1:5007", "127.3.2.1:1", "localhost:5007", "LocalHost:5007", "[::1]:5007", "::1:5007"]
        {
            assert_eq!(
                [&none, &any, &two].map(|reach| reach.check(here)),
                [Ok(()), Ok(()), Ok(())],
                "{here}"
            );
        }
        for named in ["mill-2:5007", "MILL-2:5007", "10.0.0.5:5008"] {
            assert!(
                none.check(named).is_err() && any.check(named).is_ok() && two.check(named).is_ok(),
                "{named}"
            );
        }
        for other in [
            "mill-2:5008",
            "10.0.0.5:5007",
            "169.254.169.254:80",
            "localhost.evil.org:80",
            "127.0.0.1.evil.org:80",
        ] {
            let error = two.check(other).unwrap_err();
            assert!(error.code == BAD_CONTROLLER && error.text.contains("`controllers`"), "{error}");
        }
    }

    #[test]
    fn other_words_are_refused() {
        for text in ["mill", "any,mill:5007", "mill:99999", ":5007", "linuxcnc://mill:5007:", "sim"] {
            assert!(Reach::parse(text).unwrap_err().contains("expected"), "{text}");
        }
    }
}
