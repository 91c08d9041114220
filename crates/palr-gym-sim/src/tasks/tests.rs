//! Properties that every task keeps, whichever they are.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use mujoco_rs::prelude::{MjModel, MjtObjBase};
use palr_gym_core::Mask;

use super::*;
use crate::env::Env;

fn names(model: &MjModel, kind: MjtObjBase, count: i32) -> Vec<&str> {
    (0..count as usize).map(|id| model.id_to_name(kind, id).unwrap()).collect()
}

#[test]
fn scene_files_task_modules_and_registry_stand_one_to_one() {
    let folder = |relative: &str, extension: &str| -> BTreeSet<String> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(relative);
        std::fs::read_dir(path)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|found| found == extension))
            .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
            .collect()
    };
    let names = |tasks: &[&dyn Task]| -> BTreeSet<String> {
        tasks.iter().map(|task| task.spec().name.to_owned()).collect()
    };
    let registered = names(&TASKS);
    // All but those of our own are Gymnasium's.
    let mut gymnasiums = registered.clone();
    assert!(["lane", "town", "toy"].iter().all(|own| gymnasiums.remove(*own)));
    assert_eq!(names(&TASKS_GYM5), gymnasiums);
    // Where `-v5` changed the robot, it has a scene of its own.
    let mut scenes = registered.clone();
    scenes.insert("walker2d-gym5".to_owned());
    let mut modules = folder("src/tasks", "rs");
    for helper in ["driving", "tests", "locomotion"] {
        assert!(modules.remove(helper));
    }
    assert_eq!(folder("../../scenes", "xml"), scenes);
    assert_eq!(modules, registered);
    assert!(TASKS.is_sorted_by_key(|task| task.spec().name));
    for gym5 in TASKS_GYM5 {
        let task = TASKS.iter().find(|task| task.spec().name == gym5.spec().name).unwrap();
        let has_own = scenes.contains(&format!("{}-gym5", task.spec().name));
        assert_eq!(!std::ptr::eq(task.scene(), gym5.scene()), has_own);
    }
}

#[test]
fn specs_agree_with_their_compiled_scenes() {
    for task in TASKS.into_iter().chain(TASKS_GYM5) {
        let spec = task.spec();
        let model = task.scene().model().unwrap();
        let ffi = model.ffi();
        assert_eq!(spec.physics_timestep_s, ffi.opt.timestep, "{}", spec.name);
        let cameras = names(&model, MjtObjBase::mjOBJ_CAMERA, ffi.ncam as i32);
        assert_eq!(
            BTreeSet::from_iter(cameras),
            spec.camera_names.iter().copied().collect::<BTreeSet<_>>(),
            "{}",
            spec.name
        );
        if spec.equals.is_empty() {
            // Actions and observations of our own tasks are not those of the simulation.
            continue;
        }
        assert_eq!(
            names(&model, MjtObjBase::mjOBJ_ACTUATOR, ffi.nu as i32),
            spec.action_names,
            "{}",
            spec.name
        );
        assert!(model.actuator_ctrlrange().iter().all(|range| *range == [-1.0, 1.0]));
        let is_seen = |name: &str| name.starts_with("qpos") || name == "cue";
        assert!(spec.strict_mask.iter().all(|&i| is_seen(spec.observation[i].name)));

        // Observation names follow the joints in the order of their addresses; a joint with
        // several coordinates appends each one's name after a dot.
        let joints = names(&model, MjtObjBase::mjOBJ_JOINT, ffi.njnt as i32);
        for (kind, widths) in [("qpos", [7, 4, 1, 1]), ("qvel", [6, 3, 1, 1])] {
            let expected: Vec<String> = joints
                .iter()
                .zip(model.jnt_type())
                .flat_map(|(joint, joint_type)| {
                    let width = widths[*joint_type as usize];
                    std::iter::repeat_n(format!("{kind}[{joint}]"), width)
                })
                .collect();
            let got: Vec<String> = spec
                .observation
                .iter()
                .filter(|entry| entry.name.starts_with(kind))
                .map(|entry| match entry.name.split_once('.') {
                    Some((joint, _)) => format!("{joint}]"),
                    None => entry.name.to_owned(),
                })
                .collect();
            // Positions along the track are not observed.
            assert_eq!(got, expected[expected.len() - got.len()..], "{}", spec.name);
        }
    }
}

#[test]
fn every_task_keeps_the_properties_of_an_environment() {
    for task in TASKS.into_iter().chain(TASKS_GYM5) {
        let spec = task.spec();
        let unique: BTreeSet<_> = spec.observation.iter().map(|entry| entry.name).collect();
        assert_eq!(unique.len(), spec.observation.len(), "{}", spec.name);
        for mask in Mask::ALL {
            let indices = spec.mask_indices(mask);
            if !spec.masks().any(|own| own == mask) {
                assert!(indices.is_empty());
                continue;
            }
            let gym4 = tasks(Fidelity::Gym4).iter().find(|task| task.spec().name == spec.name);
            assert!(mask == Mask::Full || indices == gym4.unwrap().spec().mask_indices(mask));
            let shows_pictures = mask.shows_pictures() && spec.agent_camera.is_some();
            assert!(indices.is_sorted_by(|a, b| a < b) && indices.is_empty() == shows_pictures);
            assert!(indices.iter().all(|&index| index < spec.observation.len()));
        }
        assert!(spec.info_names.starts_with(spec.reset_info_names), "{}", spec.name);
        let env_id = format!("{}{}", spec.name, spec.fidelity.suffix());
        let (task, env_spec) = resolve(&env_id).unwrap();
        assert_eq!(task.spec().fidelity, spec.fidelity);
        let mut env = Env::new(task, &Arc::new(env_spec)).unwrap();
        let mut info = vec![0.0; spec.info_names.len()];
        let mut low = vec![f64::INFINITY; spec.observation.len()];
        let mut high = vec![f64::NEG_INFINITY; spec.observation.len()];
        let mut generator = Generator::from_seed(1);
        env.reset(Some(0)).unwrap();
        for _ in 0..2500 {
            let action: Vec<f32> =
                spec.action_names.iter().map(|_| generator.uniform(-1.0, 1.0) as f32).collect();
            let transition = env.step(&action, &mut info);
            assert!(transition.reward.is_finite() && info.iter().all(|value| value.is_finite()));
            for (i, value) in env.observation().iter().enumerate() {
                assert!(value.abs() <= spec.observation[i].bound);
                (low[i], high[i]) = (low[i].min(*value), high[i].max(*value));
            }
            if transition.is_last() {
                env.reset(None).unwrap();
            }
        }
        // Forces on bodies that never touch anything are always zero.
        let varies = |i: usize| low[i] < high[i] || spec.observation[i].name.starts_with("cfrc");
        let constant = (0..low.len()).find(|&i| !varies(i)).map(|i| spec.observation[i].name);
        assert_eq!(constant, None, "{}", spec.name);
    }
}

#[test]
fn an_unknown_task_is_answered_with_the_nearest_one() {
    let error = resolve("hoper-w2").err().unwrap().to_string();
    assert_eq!(
        error,
        "unknown task \"hoper\" (did you mean \"hopper\"?); expected one of ant, halfcheetah, hopper, lane, town, toy, walker2d"
    );
}

#[test]
fn a_variant_that_a_task_does_not_have_is_refused_with_those_it_has() {
    for (env_id, expected) in [
        (
            "hopper-pixels",
            "task \"hopper\" has no \"pixels\" variant; expected -full or -paper or -strict",
        ),
        (
            "lane-strict",
            "task \"lane\" has no \"strict\" variant; expected -full or -paper or -pixels",
        ),
        ("lane-gym5", "task \"lane\" has no \"gym5\" variant; expected an id without it"),
    ] {
        assert_eq!(resolve(env_id).err().unwrap().to_string(), expected);
    }
    let options = Some(SceneOptions::default());
    assert!(resolve_scene("lane", options).is_ok());
    let error = resolve_scene("hopper", options).err().unwrap().to_string();
    assert!(error.contains("task \"hopper\" has no scene options"), "{error}");
    let wrong = Some(SceneOptions { lead_car_probability: 1.5, ..SceneOptions::default() });
    let error = resolve_scene("lane", wrong).err().unwrap().to_string();
    assert!(
        error.contains("lead_car_probability is 1.5; expected a number within [0, 1]"),
        "{error}"
    );
}
