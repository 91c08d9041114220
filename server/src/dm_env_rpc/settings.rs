//! Settings of requests: tensors by name, checked.

use std::collections::BTreeMap;

use palr_gym_proto::dm_env_rpc::v1::Tensor;
use palr_gym_proto::dm_env_rpc::v1::tensor::Payload;
use serde_json::{Map, Value};

use super::error::DmEnvRpcError;

type Settings = BTreeMap<String, Tensor>;

/// What a world is made from.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct WorldSettings {
    pub(super) env_id: String,
    pub(super) seed: Option<u64>,
}

const WORLD_SETTINGS: &str = "env_id, seed or args";
const ENV_ID: &str = "a string such as \"hopper-w2\"";
const SEED: &str = "a single integer from 0 to 2^64 - 1";
const ARGS: &str =
    "a string with a JSON object of env_id (or entrypoint), seed and entrypoint_kwargs";

/// How much of a stranger's text is worth quoting.
const QUOTED_CHARS: usize = 64;

pub(super) fn quoted(text: &str) -> String {
    text.chars().take(QUOTED_CHARS).collect()
}

/// Settings of CreateWorld.
pub(super) fn world(settings: &Settings) -> Result<WorldSettings, DmEnvRpcError> {
    let mut env_id = None;
    let mut world = WorldSettings::default();
    for (name, tensor) in settings {
        match name.as_str() {
            "env_id" => env_id = Some(text("env_id", tensor, ENV_ID)?.to_owned()),
            "seed" => world.seed = Some(seed_value(tensor)?),
            "args" => {}
            _ => return Err(unknown(name, WORLD_SETTINGS)),
        }
    }
    if let Some(tensor) = settings.get("args") {
        let mut named = Named::default();
        named.read_args(text("args", tensor, ARGS)?)?;
        env_id = env_id.or(named.env_id);
        world.seed = world.seed.or(named.seed);
    }
    let missing = || DmEnvRpcError::Setting { name: "env_id", got: "not set".into(), want: ENV_ID };
    world.env_id = env_id.ok_or_else(missing)?;
    Ok(world)
}

/// Settings of every other request: a seed or nothing.
pub(super) fn seed(settings: &Settings) -> Result<Option<u64>, DmEnvRpcError> {
    let other = settings.keys().find(|name| name.as_str() != "seed");
    match other {
        Some(name) => Err(unknown(name, "seed")),
        None => settings.get("seed").map(seed_value).transpose(),
    }
}

/// What remote-gym puts into `args`.
#[derive(Default)]
struct Named {
    env_id: Option<String>,
    seed: Option<u64>,
}

impl Named {
    fn read_args(&mut self, args: &str) -> Result<(), DmEnvRpcError> {
        let wrong = |got: String| DmEnvRpcError::Setting { name: "args", got, want: ARGS };
        match serde_json::from_str(args) {
            Ok(Value::Object(object)) => self.read(&object, false),
            Ok(_) => Err(wrong(quoted(args))),
            Err(error) => Err(wrong(format!("no JSON ({error})"))),
        }
    }

    fn read(&mut self, object: &Map<String, Value>, is_nested: bool) -> Result<(), DmEnvRpcError> {
        for (name, value) in object {
            let wrong =
                |name, want| DmEnvRpcError::Setting { name, got: quoted(&value.to_string()), want };
            match (name.as_str(), value) {
                // What remote-gym's type allows to be unset.
                ("repo" | "reference" | "entrypoint", Value::Null) => {}
                ("env_id" | "entrypoint", Value::String(env_id)) => {
                    self.env_id = Some(env_id.clone());
                }
                ("env_id" | "entrypoint", _) => return Err(wrong("env_id", ENV_ID)),
                ("seed", value) => {
                    self.seed = Some(value.as_u64().ok_or_else(|| wrong("seed", SEED))?);
                }
                ("entrypoint_kwargs", Value::Object(object)) if !is_nested => {
                    self.read(object, true)?;
                }
                ("repo" | "reference", _) => {
                    return Err(wrong(
                        "args",
                        "neither repo nor reference: this server runs no code of yours",
                    ));
                }
                _ => return Err(unknown(name, "env_id, entrypoint, seed or entrypoint_kwargs")),
            }
        }
        Ok(())
    }
}

fn unknown(name: &str, known: &'static str) -> DmEnvRpcError {
    DmEnvRpcError::UnknownSetting { name: quoted(name), known }
}

fn text<'a>(
    name: &'static str,
    tensor: &'a Tensor,
    want: &'static str,
) -> Result<&'a str, DmEnvRpcError> {
    match &tensor.payload {
        Some(Payload::Strings(strings)) if strings.array.len() == 1 => Ok(&strings.array[0]),
        payload => Err(DmEnvRpcError::Setting { name, got: described(payload.as_ref()), want }),
    }
}

fn seed_value(tensor: &Tensor) -> Result<u64, DmEnvRpcError> {
    let value: Option<i128> = match &tensor.payload {
        Some(Payload::Int8s(values)) => {
            only(&values.array).map(|&byte| i128::from(byte.cast_signed()))
        }
        Some(Payload::Uint8s(values)) => only(&values.array).map(|&byte| byte.into()),
        Some(Payload::Int32s(values)) => only(&values.array).map(|&value| value.into()),
        Some(Payload::Uint32s(values)) => only(&values.array).map(|&value| value.into()),
        Some(Payload::Int64s(values)) => only(&values.array).map(|&value| value.into()),
        Some(Payload::Uint64s(values)) => only(&values.array).map(|&value| value.into()),
        _ => None,
    };
    let wrong = |got| DmEnvRpcError::Setting { name: "seed", got, want: SEED };
    let value = value.ok_or_else(|| wrong(described(tensor.payload.as_ref())))?;
    u64::try_from(value).map_err(|_| wrong(value.to_string()))
}

fn only<T>(values: &[T]) -> Option<&T> {
    match values {
        [value] => Some(value),
        _ => None,
    }
}

fn described(payload: Option<&Payload>) -> String {
    format!(
        "{} elements of type {}",
        super::tensors::count(payload),
        super::tensors::type_name(payload)
    )
}

#[cfg(test)]
mod tests {
    use palr_gym_proto::dm_env_rpc::v1::tensor::{FloatArray, Int64Array, StringArray};

    use super::*;

    fn tensor(payload: Payload) -> Tensor {
        Tensor { payload: Some(payload), shape: vec![] }
    }

    fn string(text: &str) -> Tensor {
        tensor(Payload::Strings(StringArray { array: vec![text.into()] }))
    }

    fn integer(value: i64) -> Tensor {
        tensor(Payload::Int64s(Int64Array { array: vec![value] }))
    }

    fn check(settings: &[(&str, Tensor)], expected: Result<(&str, Option<u64>), &str>) {
        let settings: Settings =
            settings.iter().map(|(name, tensor)| ((*name).to_owned(), tensor.clone())).collect();
        match (world(&settings), expected) {
            (Ok(got), Ok((env_id, seed))) => {
                assert_eq!(got, WorldSettings { env_id: env_id.into(), seed });
            }
            (Err(error), Err(text)) => {
                assert!(error.to_string().contains(text), "{error} does not contain {text}");
            }
            (got, expected) => panic!("{settings:?}: got {got:?}, expected {expected:?}"),
        }
    }

    #[test]
    fn a_world_is_named_directly_or_as_remote_gym_does() {
        check(&[("env_id", string("hopper"))], Ok(("hopper", None)));
        check(&[("env_id", string("ant-w4")), ("seed", integer(7))], Ok(("ant-w4", Some(7))));
        check(
            &[("args", string(r#"{"env_id": "hopper-w2", "seed": 3}"#))],
            Ok(("hopper-w2", Some(3))),
        );
        let documented = r#"{"repo": null, "reference": null, "entrypoint": "ant", "entrypoint_kwargs": {"seed": 5}}"#;
        check(&[("args", string(documented))], Ok(("ant", Some(5))));
        check(
            &[("args", string(r#"{"seed": 5}"#)), ("env_id", string("ant")), ("seed", integer(1))],
            Ok(("ant", Some(1))),
        );
    }

    #[test]
    fn wrong_settings_are_named() {
        check(&[], Err("\"env_id\" is not set; expected a string"));
        check(&[("args", string("{}"))], Err("\"env_id\" is not set"));
        check(
            &[("env_id", string("hopper")), ("players", integer(2))],
            Err("\"players\" is unknown"),
        );
        check(&[("env_id", integer(3))], Err("\"env_id\" is 1 elements of type int64s"));
        check(&[("env_id", string("hopper")), ("seed", integer(-1))], Err("\"seed\" is -1"));
        let floats = tensor(Payload::Floats(FloatArray { array: vec![1.0] }));
        check(
            &[("env_id", string("hopper")), ("seed", floats)],
            Err("of type floats; expected a single integer"),
        );
        check(&[("args", string("hopper"))], Err("\"args\" is no JSON"));
        check(&[("args", string("[1]"))], Err("\"args\" is [1]"));
        check(
            &[("args", string(r#"{"env_id": "ant", "repo": "x"}"#))],
            Err("runs no code of yours"),
        );
        check(&[("args", string(r#"{"env_id": "ant", "seed": 1.5}"#))], Err("\"seed\" is 1.5"));
        check(
            &[("args", string(r#"{"entrypoint_kwargs": {"entrypoint_kwargs": {}}}"#))],
            Err("is unknown"),
        );
    }
}
