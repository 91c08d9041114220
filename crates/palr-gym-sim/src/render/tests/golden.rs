//! The pictures in the documentation are what is drawn, within what versions of Mesa differ by.

use std::path::Path;

use super::*;

const SIDE: usize = 320;
/// Set: the pictures are written instead of compared.
const WRITE: &str = "PALR_GYM_WRITE_PICTURES";
/// Mean difference of a channel, of 255.
const TOLERANCE: f64 = 3.0;

/// Driver and top, side by side; a clear day above random weather. The demonstrator has driven for so
/// many steps.
fn montage<const INFO: usize>(make: fn(WeatherMode) -> Env, seed: u64, steps: usize) -> Vec<u8> {
    let mut picture = vec![0; 4 * SIDE * SIDE * 3];
    for (row, weather) in [WeatherMode::Fixed, WeatherMode::Random].into_iter().enumerate() {
        let mut env = make(weather);
        env.reset(Some(seed)).unwrap();
        let mut info = [0.0; INFO];
        for _ in 0..steps {
            let mut action = [0.0; 2];
            assert!(env.controller(&mut action));
            env.step(&action, &mut info);
        }
        for (column, camera) in ["driver", "top"].into_iter().enumerate() {
            let side = SIDE as u32;
            let tile = draw(&env, View { camera: Some(camera), width_px: side, height_px: side });
            for (y, line) in tile.chunks_exact(3 * SIDE).enumerate() {
                let begin = 3 * ((row * SIDE + y) * 2 * SIDE + column * SIDE);
                picture[begin..begin + 3 * SIDE].copy_from_slice(line);
            }
        }
    }
    picture
}

#[test]
fn the_pictures_of_the_lane_in_the_docs_are_what_is_drawn() {
    compare("lane.png", || montage::<5>(env, 11, 60));
}

#[test]
fn the_pictures_of_the_town_in_the_docs_are_what_is_drawn() {
    compare("town.png", || montage::<7>(|weather| town(weather, 8), 3, 262));
}

fn compare(name: &str, draw: impl FnOnce() -> Vec<u8>) {
    if cannot_draw() {
        return;
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs").join(name);
    let (side, drawn) = (2 * SIDE as u32, draw());
    if std::env::var_os(WRITE).is_some() {
        let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), side, side);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        encoder.write_header().unwrap().write_image_data(&drawn).unwrap();
        return;
    }
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut golden = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut golden).unwrap();
    assert_eq!(golden.len(), drawn.len());
    for tile in 0..4 {
        let rows = (tile / 2) * SIDE..(tile / 2 + 1) * SIDE;
        let mut difference = 0.0;
        for row in rows {
            let begin = 3 * (row * 2 * SIDE + (tile % 2) * SIDE);
            let pairs = golden[begin..begin + 3 * SIDE].iter().zip(&drawn[begin..]);
            difference += pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>();
        }
        difference /= (3 * SIDE * SIDE) as f64;
        assert!(difference < TOLERANCE, "tile {tile} differs by {difference}");
    }
}
