//! `palr-gym bench`, against a server in its own process and against one that is elsewhere.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use serde_json::Value;

const BINARY: &str = env!("CARGO_BIN_EXE_palr-gym");

struct Serving(Child, String);

impl Serving {
    fn start() -> Self {
        let mut child = Command::new(BINARY)
            .args(["serve", "--listen", "127.0.0.1:0", "--json", "--threads", "1"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let ready: Value = serde_json::from_str(&line).unwrap();
        Self(child, ready["address"].as_str().unwrap().to_owned())
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn bench(arguments: &[&str]) -> String {
    let output = Command::new(BINARY)
        .arg("bench")
        .args(arguments)
        .env_remove("PALR_GYM_SERVER")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn rates_are_measured_in_this_process_and_elsewhere() {
    let serving = Serving::start();
    let common = ["step", "--env", "hopper-w2", "--num-envs", "8", "--seconds", "0.05"];
    for (server, in_flight) in [(None, "1"), (Some(serving.1.as_str()), "4")] {
        let mut arguments = common.to_vec();
        arguments.extend(["--repeats", "3", "--in-flight", in_flight, "--json"]);
        arguments.extend(server.iter().flat_map(|address| ["--server", address]));
        let result: Value = serde_json::from_str(&bench(&arguments)).unwrap();
        assert_eq!(result["env_id"], "hopper-w2-v0");
        assert_eq!(result["num_envs"], 8);
        assert_eq!(result["server_version"], env!("CARGO_PKG_VERSION"));
        if server.is_some() {
            assert_eq!(result["simulation_threads"], 1);
        }
        let repeats = result["repeats"].as_array().unwrap();
        let mut rates: Vec<f64> =
            repeats.iter().map(|repeat| repeat["steps_per_s"].as_f64().unwrap()).collect();
        assert_eq!(rates.len(), 3);
        rates.sort_by(f64::total_cmp);
        assert_eq!(result["steps_per_s"].as_f64().unwrap(), rates[1]);
        for repeat in repeats {
            let (steps, wall) = (repeat["env_steps"].as_f64(), repeat["wall_time_s"].as_f64());
            assert!(wall.unwrap() >= 0.05);
            let rate = steps.unwrap() / wall.unwrap();
            assert!((rate - repeat["steps_per_s"].as_f64().unwrap()).abs() < 1e-6 * rate);
        }
    }
}

#[test]
fn latencies_are_told_to_people_and_to_programs() {
    let arguments = ["latency", "--env", "hopper", "--seconds", "0.05", "--repeats", "2"];
    let text = bench(&arguments);
    for word in ["step", "empty call", "p50 µs", "hopper-v0"] {
        assert!(text.contains(word), "{text}");
    }
    let result: Value =
        serde_json::from_str(&bench(&[&arguments[..], &["--json"]].concat())).unwrap();
    for kind in ["step", "empty_call"] {
        let latency = |name: &str| result[kind][name].as_f64().unwrap();
        assert!(latency("count") >= 1.0);
        assert!(latency("p50_us") > 0.0);
        assert!(latency("p50_us") <= latency("p90_us") && latency("p99_us") <= latency("max_us"));
    }
}
