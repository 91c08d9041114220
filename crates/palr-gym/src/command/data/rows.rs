//! `palr-gym data prepare`

use std::fs::File;
use std::io::Write as _;

use palr_gym_trainer::ClientError;
use palr_gym_trainer::imitate::data::prepare;
use palr_gym_trainer::imitate::settings::Settings;
use serde_json::json;

use crate::cli::data::DataPrepareArguments;
use crate::{backend, output};

/// Writes the rows that a run with these settings would train on.
pub async fn write(arguments: &DataPrepareArguments) -> anyhow::Result<()> {
    let mut layer = json!({
        "env": arguments.env,
        "data": arguments.file,
        "statistics": arguments.statistics,
        "held_out": {},
    });
    if let Some(rows) = arguments.training_rows {
        layer["training_rows"] = json!(rows);
    }
    if let Some(rows) = arguments.held_out_rows {
        layer["held_out"]["rows"] = json!(rows);
    }
    if let Some(start) = arguments.held_out_start {
        layer["held_out"]["start"] = json!(start);
    }
    let settings = Settings::from_layers(&[layer])?;
    let client = backend::connect(&arguments.server).await?;
    let prepared = prepare(&client, &settings).await?;
    let out = &arguments.out;
    let bytes = prepared.to_safetensors()?;
    File::create_new(out)
        .and_then(|mut file| file.write_all(&bytes))
        .map_err(|error| ClientError::file(out, error))?;
    let held_out = prepared.held_out.as_ref().map_or(0, |rows| rows.len());
    let training = prepared.training.len();
    if arguments.json {
        return output::json(&json!({
            "path": out,
            "env_id": prepared.env_id,
            "training_rows": training,
            "held_out_rows": held_out,
            "observation_size": prepared.training.observation_size(),
            "action_size": prepared.training.action_size(),
            "data_sha256": prepared.identity.sha256,
        }));
    }
    println!("{}: {training} rows to train on, {held_out} held out", out.display());
    Ok(())
}
