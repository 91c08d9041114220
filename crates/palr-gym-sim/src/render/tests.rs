//! Pictures: what is in them, and that nothing but positions decides it.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, OutOfBounds, SceneOptions, WeatherMode};

use super::*;
use crate::env::Env;
use crate::error::SimError;
use crate::tasks::{resolve, resolve_scene};
use crate::threads::SimulationThreads;
use crate::vector::{StepFrame, VectorEnv, VectorOptions};

mod golden;

const SMALL: View<'_> = View { camera: Some("driver"), width_px: 48, height_px: 48 };

fn env(weather: WeatherMode) -> Env {
    let options = SceneOptions { weather, lead_car_probability: 1.0, ..SceneOptions::default() };
    driving("lane", options)
}

fn town(weather: WeatherMode, vehicles: u32) -> Env {
    driving("town", SceneOptions { weather, vehicles, ..SceneOptions::default() })
}

fn driving(name: &str, options: SceneOptions) -> Env {
    let (task, spec) = resolve_scene(name, Some(options)).unwrap();
    Env::new(task, &Arc::new(spec)).unwrap()
}

/// True on a machine without OpenGL, where these tests have nothing to test. They say so.
fn cannot_draw() -> bool {
    let (task, spec) = resolve("hopper").unwrap();
    let env = Env::new(task, &Arc::new(spec)).unwrap();
    let view = View { camera: None, width_px: 8, height_px: 8 };
    match env.draw(GlChoice::Auto, view, &mut Vec::new()) {
        Err(error @ SimError::Render(RenderError::NoGl { .. })) => {
            eprintln!("SKIPPED: {error}");
            true
        }
        drawn => {
            drawn.unwrap();
            false
        }
    }
}

fn draw(env: &Env, view: View<'_>) -> Vec<u8> {
    let mut picture = Vec::new();
    env.draw(GlChoice::Auto, view, &mut picture).unwrap();
    assert_eq!(picture.len(), (view.width_px * view.height_px * 3) as usize);
    picture
}

/// Mean colour of a part of a square picture, in tenths of its side.
fn mean(picture: &[u8], side: usize, rows: (usize, usize), columns: (usize, usize)) -> [f64; 3] {
    let (mut sum, mut count) = ([0.0; 3], 0.0);
    for row in rows.0 * side / 10..rows.1 * side / 10 {
        for column in columns.0 * side / 10..columns.1 * side / 10 {
            for (channel, total) in sum.iter_mut().enumerate() {
                *total += f64::from(picture[3 * (row * side + column) + channel]);
            }
            count += 1.0;
        }
    }
    sum.map(|total| total / count)
}

#[test]
fn the_driver_sees_sky_above_road_below_and_grass_beside() {
    if cannot_draw() {
        return;
    }
    let mut env = env(WeatherMode::Fixed);
    env.reset(Some(0)).unwrap();
    let picture = draw(&env, SMALL);
    let [red, green, blue] = mean(&picture, 48, (0, 2), (0, 10));
    assert!(blue > 150.0 && blue > green && green > red, "sky: {red} {green} {blue}");
    let [red, green, blue] = mean(&picture, 48, (9, 10), (4, 6));
    assert!((red - blue).abs() < 25.0 && (red - green).abs() < 25.0, "road: {red} {green} {blue}");
    let top = draw(&env, View { camera: Some("top"), ..SMALL });
    let [red, green, blue] = mean(&top, 48, (0, 10), (0, 10));
    assert!(green > red && green > blue, "from above: {red} {green} {blue}");
}

#[test]
fn speed_shows_in_two_frames_and_not_in_one() {
    if cannot_draw() {
        return;
    }
    // Without another car, which would drive on from one step to the next.
    let options = SceneOptions { lead_car_probability: 0.0, ..SceneOptions::default() };
    let (task, spec) = resolve_scene("lane", Some(options)).unwrap();
    let mut env = Env::new(task, &Arc::new(spec)).unwrap();
    env.reset(Some(0)).unwrap();
    let (qpos, qvel) = (env.state().qpos().to_vec(), vec![0.0; env.state().qvel().len()]);
    let mut pictures = Vec::new();
    for speed_mps in [0.0, 5.0] {
        let mut moving = qvel.clone();
        let heading = 2.0 * qpos[6].atan2(qpos[3]);
        (moving[0], moving[1]) = (speed_mps * heading.cos(), speed_mps * heading.sin());
        env.set_state(&qpos, &moving).unwrap();
        let before = draw(&env, SMALL);
        env.step(&[0.0; 2], &mut [0.0; 5]);
        pictures.push((before, draw(&env, SMALL)));
    }
    assert!(pictures[0].0 == pictures[1].0);
    assert!(pictures[0].1 != pictures[1].1);
}

#[test]
fn drawing_changes_no_bit_of_a_simulation_and_a_restored_one_looks_the_same() {
    if cannot_draw() {
        return;
    }
    let (task, spec) = resolve("lane").unwrap();
    let options = VectorOptions {
        autoreset_mode: AutoresetMode::NextStep,
        out_of_bounds: OutOfBounds::Reject,
    };
    let threads = SimulationThreads::start(2).unwrap();
    let new = || VectorEnv::new(task, spec.clone(), 3, options, threads.clone()).unwrap();
    let (mut drawn, mut blind, mut frame) = (new(), new(), StepFrame::default());
    drawn.reset(&[5], &[]).unwrap();
    blind.reset(&[5], &[]).unwrap();
    let mut picture = Vec::new();
    for step in 0..30 {
        let actions = [0.5, 0.1, 0.3, -0.2, -0.1 * f32::from(step as u8 % 3), 0.0];
        drawn.step(&actions, &mut frame).unwrap();
        drawn.draw(step % 3, GlChoice::Auto, SMALL, &mut picture).unwrap();
        blind.step(&actions, &mut frame).unwrap();
    }
    let bytes = drawn.snapshot(0);
    assert!(bytes == blind.snapshot(0));
    let mut restored = new();
    restored.restore(&crate::Snapshot::parse(&bytes).unwrap()).unwrap();
    let mut again = Vec::new();
    for index in 0..3 {
        drawn.draw(index, GlChoice::Auto, SMALL, &mut picture).unwrap();
        restored.draw(index, GlChoice::Auto, SMALL, &mut again).unwrap();
        assert!(picture == again, "{index}");
    }
}

#[test]
fn frames_do_not_depend_on_the_thread_that_draws_them() {
    if cannot_draw() {
        return;
    }
    // Lane and town by turns, so that every thread has both scenes at hand.
    let picture = |seed: u64| {
        let mut env = if seed.is_multiple_of(2) {
            env(WeatherMode::Random)
        } else {
            town(WeatherMode::Random, 8)
        };
        env.reset(Some(seed)).unwrap();
        draw(&env, SMALL)
    };
    let alone: Vec<_> = (0..4).map(picture).collect();
    assert!(alone[0] != alone[1]);
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|first| {
                scope.spawn(move || {
                    (0..12_u64)
                        .map(|i| ((first + i) % 4, picture((first + i) % 4)))
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        for thread in threads {
            for (seed, drawn) in thread.join().unwrap() {
                assert!(drawn == alone[seed as usize], "seed {seed}");
            }
        }
    });
}

#[test]
fn what_is_left_out_would_not_have_been_seen() {
    if cannot_draw() {
        return;
    }
    let mut left_out = 0;
    for name in ["lane", "town", "ant"] {
        for seed in 0..12 {
            let options = SceneOptions { weather: WeatherMode::Random, ..SceneOptions::default() };
            let options = (name != "ant").then_some(options);
            let (task, spec) = resolve_scene(name, options).unwrap();
            let mut env = Env::new(task, &Arc::new(spec)).unwrap();
            env.reset(Some(seed)).unwrap();
            for &camera in task.spec().camera_names {
                for (width, height) in [(96, 96), (200, 40), (30, 120)] {
                    let mut draw = |culls: bool| {
                        let drawn = task.scene().on_workbench(|physics| {
                            physics.load(env.state()).unwrap();
                            canvas::with_canvas(GlChoice::Auto, physics.model(), |canvas| {
                                canvas.pose(physics, Some(camera))?;
                                canvas.set_pieces(task.pieces(physics).as_ref());
                                let geoms = canvas.geoms();
                                if culls {
                                    canvas.cull(width, height);
                                }
                                left_out += geoms - canvas.geoms();
                                canvas.set_weather(task.weather(physics).as_ref());
                                Ok(canvas.draw(width, height)?.to_vec())
                            })
                        });
                        drawn.unwrap().unwrap()
                    };
                    let whole = draw(false);
                    let what = format!("{name} {seed} {camera} {width} x {height}");
                    assert!(draw(true) == whole, "{what}");
                }
            }
        }
    }
    assert!(left_out > 1000, "{left_out}");
}

#[test]
fn a_town_shows_the_streets_of_its_seed_and_no_others() {
    if cannot_draw() {
        return;
    }
    let mut env = town(WeatherMode::Fixed, 0);
    let view = View { camera: Some("top"), width_px: 200, height_px: 200 };
    let mut towns = Vec::new();
    for seed in 0..4 {
        env.reset(Some(seed)).unwrap();
        let picture = draw(&env, view);
        towns.push((picture, crate::tasks::town_scene_mjcf(seed)));
    }
    for (index, (picture, _)) in towns.iter().enumerate() {
        assert!(towns[..index].iter().all(|(other, _)| other != picture), "{index}");
    }
    // Not green on a street that is there, green where there is none, in the middles of all 24. In the
    // scene of a seed what its map lacks is in a group.
    for (seed, (picture, text)) in towns.iter().enumerate() {
        let mut found = 0;
        for line in text.lines().filter(|line| line.contains("mesh=\"street_road\"")) {
            let part = line.split("pos=\"").nth(1).unwrap();
            let mut numbers = part.split([' ', '"']).map(|number| number.parse::<f64>());
            let (x, y) = (numbers.next().unwrap().unwrap(), numbers.next().unwrap().unwrap());
            // 150 m up, 60 degrees: 173.2 m across 200 pixels.
            let pixel = |metres: f64| (100.0 + metres * 200.0 / 173.2) as usize;
            // Beside the dashes.
            let index = 3 * (pixel(-y - 1.9) * 200 + pixel(x + 1.9));
            let [red, green, blue] = [0, 1, 2].map(|channel| i32::from(picture[index + channel]));
            let is_green = green - red > 15 && green - blue > 20;
            assert_eq!(
                is_green,
                line.contains("group="),
                "seed {seed}: {line} {red} {green} {blue}"
            );
            found += 1;
        }
        assert_eq!(found, 24);
    }
}

#[test]
fn weather_changes_pictures_and_not_the_physics() {
    if cannot_draw() {
        return;
    }
    let (mut fixed, mut random) = (env(WeatherMode::Fixed), env(WeatherMode::Random));
    let mut brightness = Vec::new();
    for seed in 0..6 {
        fixed.reset(Some(seed)).unwrap();
        random.reset(Some(seed)).unwrap();
        for _ in 0..5 {
            let action = [0.4, -0.1];
            let (mut a, mut b) = ([0.0; 5], [0.0; 5]);
            assert_eq!(fixed.step(&action, &mut a), random.step(&action, &mut b));
            assert_eq!(a, b);
        }
        let (clear, drawn) = (draw(&fixed, SMALL), draw(&random, SMALL));
        assert!(clear != drawn, "seed {seed}");
        let [red, green, blue] = mean(&drawn, 48, (5, 10), (0, 10));
        brightness.push(red + green + blue);
    }
    let span = brightness.iter().copied().fold(0.0, f64::max)
        - brightness.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(span > 30.0, "{brightness:?}");
}

#[test]
fn every_task_can_be_drawn_at_any_size() {
    if cannot_draw() {
        return;
    }
    for task in crate::tasks::TASKS {
        let (task, spec) = resolve(task.spec().name).unwrap();
        let spec = Arc::new(spec);
        let mut env = Env::new(task, &spec).unwrap();
        env.reset(Some(0)).unwrap();
        for (width_px, height_px) in [(1, 1), (7, 300), (1030, 5)] {
            let camera = Some(spec.task.camera_names[0]);
            let named = draw(&env, View { camera, width_px, height_px });
            assert!(named == draw(&env, View { camera: None, width_px, height_px }));
        }
        let picture = draw(&env, View { camera: None, width_px: 64, height_px: 64 });
        assert!(picture.iter().any(|&value| value != picture[0]), "{}: blank", spec.task.name);
    }
    let info = gl_info().unwrap();
    assert!(info.renderer.contains("pipe") && info.version.contains("Mesa"), "{info:?}");
}

#[test]
fn what_cannot_be_drawn_is_refused_with_a_reason() {
    if cannot_draw() {
        return;
    }
    let mut env = env(WeatherMode::Fixed);
    env.reset(Some(0)).unwrap();
    let mut picture = Vec::new();
    let mut refuse = |choice, camera, width_px, height_px| {
        let view = View { camera, width_px, height_px };
        env.draw(choice, view, &mut picture).unwrap_err().to_string()
    };
    assert!(refuse(GlChoice::None, None, 48, 48).contains("--gl auto"));
    for (width, height) in [(0, 48), (48, 0), (10_000, 48), (48, 2049)] {
        let message = refuse(GlChoice::Auto, None, width, height);
        assert!(message.contains("expected 1 to 2048 each way"), "{message}");
    }
    let message = refuse(GlChoice::Auto, Some("drone"), 48, 48);
    assert_eq!(message, "the scene has no camera \"drone\"; expected top, driver, chase");
    // A process keeps to the library that it began with.
    let other = match gl_info().unwrap().library {
        "osmesa" => GlChoice::Egl,
        _ => GlChoice::Osmesa,
    };
    let message = refuse(other, None, 48, 48);
    assert!(message.contains("needs a process of its own"), "{message}");
}

/// Set for the child process of the test below: what it shall draw with.
const CHILD_GL: &str = "PALR_GYM_TEST_GL";

/// A process draws with one library only, so the other one draws in a process of its own.
#[test]
fn egl_draws_what_osmesa_draws() {
    let mut envs = [env(WeatherMode::Random), town(WeatherMode::Random, 8)];
    envs.iter_mut().for_each(|env| env.reset(Some(3)).unwrap());
    let checksum = |choice| -> Result<String, SimError> {
        let (mut picture, mut all) = (Vec::new(), Vec::new());
        for env in &envs {
            env.draw(choice, SMALL, &mut picture)?;
            all.extend_from_slice(&picture);
        }
        Ok(format!("{:08x}", crc32fast::hash(&all)))
    };
    if std::env::var_os(CHILD_GL).is_some() {
        println!("FRAME {:?}", checksum(GlChoice::Egl));
        return;
    }
    let expected = match checksum(GlChoice::Osmesa) {
        Ok(expected) => format!("FRAME {:?}", Ok::<_, SimError>(expected)),
        Err(error) => {
            eprintln!("SKIPPED: {error}");
            return;
        }
    };
    let child = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["render::tests::egl_draws_what_osmesa_draws", "--exact", "--nocapture"])
        .env(CHILD_GL, "egl")
        .output()
        .unwrap();
    let output = String::from_utf8(child.stdout).unwrap();
    if output.contains("NoGl") {
        eprintln!("SKIPPED: there is no EGL: {output}");
        return;
    }
    assert!(output.contains(&expected), "{output}, not {expected}");
}
