//! Whether a controller answers.

use patchmill_machine_interface::linuxcnc::client::{address, greets};

use super::Finding;

const CHECK: &str = "controller";

/// Asks a controller by its name, without telling it to do anything.
pub fn controller(name: &str) -> Finding {
    if name == "sim" {
        return Finding::good(CHECK, "sim runs in machine_interface itself");
    }
    let Some(address) = address(name) else {
        return Finding::bad(
            CHECK,
            format!("`{name}` names no controller"),
            "give sim or linuxcnc://HOST:PORT",
        );
    };
    match greets(address) {
        Ok(()) => Finding::good(CHECK, format!("linuxcncrsh answers at {name}")),
        Err(why) => Finding::bad(
            CHECK,
            format!("{name}: {why}"),
            "start LinuxCNC with linuxcncrsh on that port (a simulation: patchmill linuxcnc-config --out DIR, bash DIR/start.sh) and let the firewall pass it",
        ),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader, Write};
    use std::net::TcpListener;

    use super::*;
    use crate::terminal::Mood;

    #[test]
    fn who_greets_back_is_there_and_nobody_else() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let name = format!("linuxcnc://{}", listener.local_addr().unwrap());
        let server = std::thread::spawn(move || {
            for answer in ["HELLO ACK EMCNETSVR 1.1\r\n", "SMTP ready\r\n"] {
                let (mut stream, _) = listener.accept().unwrap();
                let mut line = String::new();
                BufReader::new(stream.try_clone().unwrap()).read_line(&mut line).unwrap();
                assert!(line.starts_with("hello"), "{line}");
                stream.write_all(answer.as_bytes()).unwrap();
            }
        });
        assert_eq!(controller(&name).state, Mood::Good);
        assert_eq!(controller(&name).state, Mood::Bad);
        server.join().unwrap();
        let finding = controller(&name);
        assert!(finding.state == Mood::Bad && finding.advice.contains("linuxcnc-config"), "{finding:?}");
        assert!(controller("fanuc").advice.contains("linuxcnc://HOST:PORT"));
        assert_eq!(controller("sim").state, Mood::Good);
    }
}
