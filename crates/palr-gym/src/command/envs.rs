//! `palr-gym envs`

use palr_gym_proto::v1;
use serde_json::{Value, json};

use crate::backend;
use crate::cli::EnvsArguments;
use crate::output;

/// Lists tasks or describes one environment.
pub async fn run(arguments: EnvsArguments) -> anyhow::Result<()> {
    let client = backend::connect(&arguments.server).await?;
    match &arguments.env {
        Some(env_id) => {
            let spec = client.spec(env_id).await?;
            if arguments.json { output::json(&spec_json(&spec)) } else { print_spec(&spec) }
        }
        None => {
            let tasks = client.tasks().await?;
            if arguments.json {
                return output::json(&tasks.iter().map(task_json).collect::<Vec<_>>());
            }
            print_tasks(&tasks);
            Ok(())
        }
    }
}

fn mask_name(mask: i32) -> &'static str {
    match v1::Mask::try_from(mask) {
        Ok(v1::Mask::Full) => "full",
        Ok(v1::Mask::Paper) => "paper",
        Ok(v1::Mask::Strict) => "strict",
        Ok(v1::Mask::Pixels) => "pixels",
        Ok(v1::Mask::Unspecified) | Err(_) => "unknown",
    }
}

fn references(returns: Option<&v1::ReferenceReturns>) -> (f64, f64) {
    returns.map_or((f64::NAN, f64::NAN), |returns| (returns.random, returns.expert))
}

fn print_tasks(tasks: &[v1::Task]) {
    let rows = tasks
        .iter()
        .map(|task| {
            let sizes = task
                .masks
                .iter()
                .map(|mask| match (mask_name(mask.mask), mask.indices.len()) {
                    // Made of the picture that the agent sees.
                    ("pixels", 0) => "pixels".to_owned(),
                    (name, 0) => format!("{name}: features"),
                    (name, count) => format!("{name} {count}"),
                })
                .collect::<Vec<_>>();
            let (random, expert) = references(task.reference_returns.as_ref());
            vec![
                task.name.clone(),
                task.equals.clone(),
                sizes.join(", "),
                task.action_size.to_string(),
                format!("{random:.1} / {expert:.1}"),
                task.expert.as_ref().map_or_else(
                    || "none".to_owned(),
                    |expert| format!("yes ({:.0})", expert.card_return),
                ),
            ]
        })
        .collect();
    let header =
        ["task", "equals", "observation", "actions", "return at score 0 / 100", "expert (return)"];
    println!("{}", output::table(&header, rows, 6));
    println!(
        "An environment is TASK[-full|-paper|-strict|-pixels][-gym5][-wN], such as hopper-w2; `palr-gym envs hopper-w2` describes it."
    );
}

fn print_spec(spec: &v1::EnvironmentSpec) -> anyhow::Result<()> {
    let (random, expert) = references(spec.reference_returns.as_ref());
    println!(
        "{}: task {}{}; mask {}, frame stack {}\n\
         {} steps of {} s ({} physics steps of {} s); score 0 is a return of {random}, 100 of {expert}; expert: {}\n\
         info: {}; cameras: {}",
        spec.env_id,
        spec.task,
        if spec.equals.is_empty() { String::new() } else { format!(", as {}", spec.equals) },
        mask_name(spec.mask),
        spec.frame_stack,
        spec.max_episode_steps,
        spec.control_timestep_s,
        spec.frame_skip,
        spec.physics_timestep_s,
        if spec.has_expert { "yes" } else { "none" },
        spec.info_names.join(", "),
        spec.camera_names.join(", "),
    );
    for (label, space) in [("observation", &spec.observation_space), ("action", &spec.action_space)]
    {
        let Some(space) = space else { continue };
        if space.names.is_empty() {
            let dtype = dtype_name(space.dtype());
            println!(
                "{label}: {dtype} {:?} within {:?} to {:?}",
                space.shape, space.low, space.high
            );
            continue;
        }
        let rows = (0..space.names.len())
            .map(|i| {
                vec![
                    i.to_string(),
                    space.names[i].clone(),
                    format!("{}", space.low[i]),
                    format!("{}", space.high[i]),
                ]
            })
            .collect();
        println!("{}", output::table(&[label, "name", "low", "high"], rows, 2));
    }
    Ok(())
}

fn dtype_name(dtype: v1::DataType) -> &'static str {
    match dtype {
        v1::DataType::Uint8 => "uint8",
        v1::DataType::Float32 => "float32",
        v1::DataType::Float64 | v1::DataType::Bool | v1::DataType::Unspecified => "float64",
    }
}

/// JSON has no infinity: an unbounded side is null.
fn space_json(space: Option<&v1::BoxSpace>) -> Value {
    let finite = |bounds: &[f64]| -> Vec<Option<f64>> {
        bounds.iter().map(|bound| bound.is_finite().then_some(*bound)).collect()
    };
    space.map_or(Value::Null, |space| {
        json!({
            "dtype": dtype_name(space.dtype()),
            "shape": space.shape,
            "low": finite(&space.low),
            "high": finite(&space.high),
            "names": space.names,
        })
    })
}

fn spec_json(spec: &v1::EnvironmentSpec) -> Value {
    let (random, expert) = references(spec.reference_returns.as_ref());
    json!({
        "env_id": spec.env_id,
        "task": spec.task,
        "equals": spec.equals,
        "mask": mask_name(spec.mask),
        "mask_indices": spec.mask_indices,
        "frame_stack": spec.frame_stack,
        "observation_space": space_json(spec.observation_space.as_ref()),
        "action_space": space_json(spec.action_space.as_ref()),
        "max_episode_steps": spec.max_episode_steps,
        "frame_skip": spec.frame_skip,
        "physics_timestep_s": spec.physics_timestep_s,
        "control_timestep_s": spec.control_timestep_s,
        "info_names": spec.info_names,
        "reset_info_names": spec.reset_info_names,
        "camera_names": spec.camera_names,
        "reference_returns": { "random": random, "expert": expert },
        "has_expert": spec.has_expert,
        "feature_extractor": spec.feature_extractor.as_ref().map(|extractor| json!({
            "name": extractor.name,
            "sha256": extractor.sha256,
            "size": extractor.size,
            "height_px": extractor.height_px,
            "width_px": extractor.width_px,
        })),
    })
}

fn task_json(task: &v1::Task) -> Value {
    let (random, expert) = references(task.reference_returns.as_ref());
    let masks: serde_json::Map<String, Value> = task
        .masks
        .iter()
        .map(|mask| (mask_name(mask.mask).to_owned(), json!(mask.indices)))
        .collect();
    json!({
        "name": task.name,
        "description": task.description,
        "equals": task.equals,
        "full_observation_size": task.full_observation_size,
        "action_size": task.action_size,
        "max_episode_steps": task.max_episode_steps,
        "masks": masks,
        "reference_returns": { "random": random, "expert": expert },
        "expert": task.expert.as_ref().map(|expert| json!({
            "sha256": expert.sha256,
            "card_return": expert.card_return,
            "model_card": expert.model_card,
        })),
    })
}
