//! Plays the episodes whose mean returns are score 0 and score 100 of a driving task, and writes
//! them beside its scene: `cargo run -p palr-gym-sim --example reference-scores -- lane town`.
//!
//! `palr-gym evaluate --env lane --policy expert` (or `random`) `--seed 0 --episodes 200` plays the
//! same ones.

#![allow(clippy::print_stdout, reason = "a program for the console")]

use std::error::Error;
use std::path::Path;
use std::sync::Arc;

use palr_gym_core::random::Generator;
use palr_gym_sim::{Env, resolve};

const EPISODES: u64 = 200;
/// The stream from which the server's random policy draws, too.
const STREAM_OF_ACTIONS: u64 = 1;

fn main() -> Result<(), Box<dyn Error>> {
    let names: Vec<String> = std::env::args().skip(1).collect();
    if names.is_empty() {
        return Err("expected the names of tasks: lane, town".into());
    }
    names.iter().try_for_each(|name| write_scores(name))
}

fn write_scores(name: &str) -> Result<(), Box<dyn Error>> {
    let (task, spec) = resolve(name)?;
    let spec = Arc::new(spec);
    let mut env = Env::new(task, &spec)?;
    let mut info = vec![0.0; spec.task.info_names.len()];
    let mut play = |seed: u64, is_expert: bool| -> Result<f64, Box<dyn Error>> {
        env.reset(Some(seed))?;
        let mut generator = Generator::from_seed_and_stream(seed, STREAM_OF_ACTIONS);
        let mut action = vec![0.0; spec.action_size()];
        let mut episode_return = 0.0;
        loop {
            if is_expert {
                env.controller(&mut action);
            } else {
                action.fill_with(|| generator.uniform(-1.0, 1.0) as f32);
            }
            let transition = env.step(&action, &mut info);
            episode_return += transition.reward;
            if transition.is_last() {
                return Ok(episode_return);
            }
        }
    };
    let mut parts = Vec::new();
    for (policy, is_expert) in [("expert", true), ("random", false)] {
        let returns =
            (0..EPISODES).map(|seed| play(seed, is_expert)).collect::<Result<Vec<_>, _>>()?;
        let mean = returns.iter().sum::<f64>() / EPISODES as f64;
        let square = |value: &f64| (value - mean) * (value - mean);
        let deviation = (returns.iter().map(square).sum::<f64>() / (EPISODES as f64 - 1.0)).sqrt();
        println!("{name}, {policy}: {mean:.2} ± {deviation:.2} over {EPISODES} episodes");
        let list = returns.iter().map(|value| format!("{value:.6}")).collect::<Vec<_>>().join(", ");
        parts.push(format!(
            "  \"{policy}\": {{\n    \"mean\": {mean:.6},\n    \"deviation\": {deviation:.6},\n    \
             \"returns\": [{list}]\n  }}"
        ));
    }
    let text = format!(
        "{{\n  \"task\": \"{name}\",\n  \"first_seed\": 0,\n  \"episodes\": {EPISODES},\n{}\n}}\n",
        parts.join(",\n")
    );
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    Ok(std::fs::write(path.join(format!("{name}.reference.json")), text)?)
}
