//! `palr-gym render`: files that other programs can read.
#![allow(clippy::unwrap_used, reason = "a test may stop where it stands")]
#![allow(clippy::print_stderr, reason = "what is skipped is said aloud")]

use std::path::Path;
use std::process::{Command, Output};

fn render(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_palr-gym"))
        .arg("render")
        .args(arguments)
        .current_dir(folder)
        .env_remove("PALR_GYM_SERVER")
        .output()
        .unwrap()
}

/// Runs it and returns what it wrote; `None`, said aloud, on a machine without OpenGL.
fn file(arguments: &[&str], name: &str) -> Option<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let output = render(folder.path(), &[arguments, &["--out", name]].concat());
    let said = String::from_utf8(output.stderr).unwrap();
    if said.contains("no OpenGL to draw with") {
        eprintln!("SKIPPED: {said}");
        return None;
    }
    assert!(output.status.success(), "{said}");
    Some(std::fs::read(folder.path().join(name)).unwrap())
}

const RANDOM: [&str; 6] = ["--env", "hopper", "--policy", "random", "--size", "64x48"];

#[test]
fn a_gif_has_a_picture_for_the_reset_and_one_for_each_step() {
    let Some(bytes) = file(&[&RANDOM[..], &["--steps", "5"]].concat(), "a.gif") else { return };
    let mut decoder = gif::DecodeOptions::new().read_info(&bytes[..]).unwrap();
    let mut count = 0;
    while let Some(frame) = decoder.read_next_frame().unwrap() {
        assert_eq!((frame.width, frame.height), (64, 48));
        count += 1;
    }
    assert_eq!(count, 6);
}

#[test]
fn a_png_is_the_picture_after_the_step_asked_for() {
    let picture = |step: &str| {
        let bytes = file(&[&RANDOM[..], &["--step", step]].concat(), "a.png")?;
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!((info.width, info.height), (64, 48));
        Some(rgb)
    };
    let (Some(first), Some(later)) = (picture("0"), picture("12")) else { return };
    assert!(first != later);
    assert!(first == picture("0").unwrap());
}

#[test]
fn what_cannot_be_written_is_refused_before_anything_is_played() {
    for (arguments, code, expected) in [
        (
            &["--env", "lane", "--out", "a.bmp"][..],
            1,
            "expected a file ending in .png, .mp4 or .gif",
        ),
        (&["--env", "lane", "--size", "12", "--out", "a.png"], 64, "expected WIDTHxHEIGHT"),
        (&["--env", "lane", "--gl", "vulkan", "--out", "a.png"], 64, "auto, osmesa, egl, none"),
        (&["--env", "lane", "--gl", "none", "--out", "a.png"], 64, "--gl auto"),
        (&["--env", "lane", "--size", "0x9", "--out", "a.png"], 64, "expected 1 to 2048 each way"),
        (&["--out", "a.png"], 64, "--env"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let output = render(folder.path(), arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        if said.contains("no OpenGL to draw with") {
            eprintln!("SKIPPED: {said}");
            continue;
        }
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(expected), "{arguments:?}: {said}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
