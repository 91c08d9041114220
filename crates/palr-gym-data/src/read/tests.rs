use std::path::PathBuf;
use std::str::FromStr;

use hdf5_metno::types::{VarLenAscii, VarLenUnicode};
use hdf5_metno::{File, Group, H5Type};
use ndarray::{Array, Array1, Array2, ArrayView, Axis, Dimension, Slice};
use tempfile::TempDir;

use super::*;

const N: usize = 6;

/// Entry (t, j), exact in float32.
fn observations() -> Array2<f64> {
    Array2::from_shape_fn((N, 3), |(t, j)| t as f64 + j as f64 / 8.0)
}

fn actions() -> Array2<f64> {
    Array2::from_shape_fn((N, 2), |(t, j)| (t as f64 - 2.0) / 4.0 + j as f64 / 8.0)
}

fn rewards() -> Array1<f64> {
    Array1::from_shape_fn(N, |t| t as f64 / 2.0)
}

fn flags(row: usize) -> Array1<u8> {
    Array1::from_shape_fn(N, |t| u8::from(t == row))
}

fn put<'a, T: H5Type, D: Dimension>(
    file: &Group,
    name: &str,
    values: impl Into<ArrayView<'a, T, D>>,
) {
    file.new_dataset_builder().with_data(values).create(name).unwrap();
}

fn narrow<D: Dimension>(values: &Array<f64, D>) -> Array<f32, D> {
    values.mapv(|value| value as f32)
}

/// A right file: episodes of rows 0-1, 2-3, 4-5, the last one without a flag.
fn put_all(file: &Group) {
    put(file, "observations", &narrow(&observations()));
    put(file, "actions", &narrow(&actions()));
    put(file, "rewards", &narrow(&rewards()));
    put(file, "terminals", &flags(1).mapv(|flag| flag == 1));
    put(file, "timeouts", &flags(3).mapv(|flag| flag == 1));
}

/// A right file, changed by `change`.
fn file(change: impl FnOnce(&File)) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data.hdf5");
    let file = File::create(&path).unwrap();
    put_all(&file);
    change(&file);
    file.close().unwrap();
    (folder, path)
}

fn replace<'a, T: H5Type, D: Dimension>(
    file: &File,
    name: &str,
    values: impl Into<ArrayView<'a, T, D>>,
) {
    file.unlink(name).unwrap();
    put(file, name, values);
}

fn check_reads(what: &str, change: impl FnOnce(&File)) {
    let (_folder, path) = file(change);
    let read = RecordedFile::open(&path).unwrap_or_else(|error| panic!("{what}: {error}"));
    for rows in [0..N, 1..4, 5..6] {
        let got = read.rows(rows.clone()).unwrap();
        let part = Slice::from(rows);
        assert_eq!(got.observations, narrow(&observations()).slice_axis(Axis(0), part), "{what}");
        assert_eq!(got.actions, narrow(&actions()).slice_axis(Axis(0), part), "{what}");
        assert_eq!(got.rewards, narrow(&rewards()).slice_axis(Axis(0), part), "{what}");
    }
    let outline = read.outline();
    assert_eq!(outline.episodes, [0..2, 2..4, 4..6], "{what}");
    assert_eq!((outline.terminated, outline.timed_out), (1, 1), "{what}");
    assert_eq!((outline.env_id.as_deref(), outline.transitions()), (None, N), "{what}");
}

/// Every message names the file, then what is wrong in it and what was expected.
fn check_refused(expected: &str, change: impl FnOnce(&File)) {
    let (_folder, path) = file(change);
    check_path_refused(expected, &path);
}

fn check_path_refused(expected: &str, path: &Path) {
    let read = RecordedFile::open(path).and_then(|file| {
        let rows = 0..file.outline().transitions();
        file.rows(rows).map(|_| ())
    });
    let error = read.unwrap_err().to_string();
    assert!(error.starts_with(&format!("{}: ", path.display())), "{error}");
    assert!(error.contains(expected), "{error}");
}

#[test]
fn files_are_read_whatever_types_and_ranks_they_use() {
    check_reads("as our own writer does", |_| ());
    check_reads("float64 everywhere", |file| {
        replace(file, "observations", &observations());
        replace(file, "actions", &actions());
        replace(file, "rewards", &rewards());
    });
    check_reads("uint8 and int8 flags", |file| {
        replace(file, "terminals", &flags(1));
        replace(file, "timeouts", &flags(3).mapv(|flag| flag as i8));
    });
    check_reads("int64 and float32 flags", |file| {
        replace(file, "terminals", &flags(1).mapv(i64::from));
        replace(file, "timeouts", &flags(3).mapv(f32::from));
    });
    check_reads("columns of width 1", |file| {
        replace(file, "rewards", &narrow(&rewards()).insert_axis(Axis(1)));
        replace(file, "terminals", &flags(1).insert_axis(Axis(1)));
        replace(file, "timeouts", &flags(3).mapv(|flag| flag == 1).insert_axis(Axis(1)));
    });
    check_reads("chunks that are compressed", |file| {
        file.unlink("observations").unwrap();
        let builder = file.new_dataset_builder().chunk((4, 2)).shuffle().deflate(4);
        builder.with_data(&observations()).create("observations").unwrap();
    });
    check_reads("data sets and groups that are nobody's business", |file| {
        put(&file.create_group("infos").unwrap(), "qpos", &rewards());
        put(file, "next_observations", &rewards());
        put(&file.create_group("metadata").unwrap(), "env_id", &rewards());
    });
}

/// `testdata/make_d4rl_like.py` wrote the file with h5py and says what is in it.
#[test]
fn a_file_as_d4rl_and_h5py_write_it_is_read() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/d4rl_like.hdf5");
    let file = RecordedFile::open(&path).unwrap();
    let read = file.rows(0..12).unwrap();
    let entry = |(t, j): (usize, usize)| t as f32 + j as f32 / 16.0;
    assert_eq!(read.observations, Array2::from_shape_fn((12, 11), entry));
    let entry = |(t, j): (usize, usize)| (t as f32 - 6.0) / 8.0 + j as f32 / 32.0;
    assert_eq!(read.actions, Array2::from_shape_fn((12, 3), entry));
    assert_eq!(read.rewards, Array1::from_shape_fn(12, |t| t as f32 / 4.0));
    let outline = file.outline();
    assert_eq!(outline.episodes, [0..5, 5..9, 9..12]);
    assert_eq!((outline.terminated, outline.timed_out), (1, 1));
    assert_eq!(outline.env_id, None);
}

#[test]
fn the_environment_is_read_from_any_kind_of_string() {
    fn check<T: H5Type>(value: &T) {
        let (_folder, path) = file(|file| {
            let group = file.create_group("metadata").unwrap();
            let dataset = group.new_dataset::<T>().create("env_id").unwrap();
            dataset.write_scalar(value).unwrap();
        });
        let read = RecordedFile::open(&path).unwrap();
        let env_id = read.outline().env_id.as_deref();
        assert_eq!(env_id, Some("hopper-v0"), "{:?}", T::type_descriptor());
    }
    check(&VarLenUnicode::from_str("hopper-v0").unwrap());
    check(&VarLenAscii::from_ascii("hopper-v0").unwrap());
    check(&FixedUnicode::<9>::from_str("hopper-v0").unwrap());
    check(&FixedAscii::<20>::from_ascii("hopper-v0").unwrap());
}

#[test]
fn what_is_no_hdf5_file_is_named_for_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data.hdf5");
    check_path_refused("cannot read the file: No such file or directory", &path);
    fs::write(&path, "").unwrap();
    check_path_refused("not an HDF5 file: it is empty; expected an HDF5 file in D4RL", &path);
    fs::write(&path, "<!DOCTYPE html><html>404</html>").unwrap();
    check_path_refused("it starts with \"<!DOCTYPE html><html>404\"", &path);
    check_path_refused("cannot read the folder: there is no main_data.hdf5 in it", folder.path());
}

#[test]
fn a_truncated_file_is_refused_wherever_it_was_cut() {
    let (_folder, path) = file(|_| ());
    let whole = fs::read(&path).unwrap();
    for length in [8, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        check_path_refused(&format!("cut short or damaged ({length} bytes; HDF5 says: "), &path);
    }
}

#[test]
fn missing_data_sets_are_named_with_what_there_is_instead() {
    check_refused(
        "has no data set observations, the observation before each action; \
         found actions, rewards, terminals, timeouts",
        |file| file.unlink("observations").unwrap(),
    );
    check_refused("has no data set actions, the action of each", |file| {
        file.unlink("actions").unwrap();
    });
    check_refused("has no data set rewards", |file| file.unlink("rewards").unwrap());
    check_refused("has no data set terminals", |file| file.unlink("terminals").unwrap());
    check_refused("without it these ends are unknown", |file| file.unlink("timeouts").unwrap());
    check_refused("episode_18, episode_19 and 1 more", |file| {
        for name in ["observations", "actions", "rewards", "terminals", "timeouts"] {
            file.unlink(name).unwrap();
        }
        for i in [0, 1, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 2] {
            file.create_group(&format!("episode_{i}")).unwrap();
        }
    });
    check_refused("cannot read actions: ", |file| {
        file.unlink("actions").unwrap();
        file.create_group("actions").unwrap();
    });
}

#[test]
fn wrong_shapes_are_refused() {
    check_refused("observations has shape [6]; expected [N, observation size]", |file| {
        replace(file, "observations", &rewards());
    });
    check_refused("observations has shape [6, 0]; expected [N, observation size]", |file| {
        replace(file, "observations", &Array2::<f32>::zeros((N, 0)));
    });
    check_refused("actions has shape [6, 2, 1]; expected [N, action size]", |file| {
        replace(file, "actions", &actions().insert_axis(Axis(2)));
    });
    check_refused("rewards has shape [6, 2]; expected [N] or [N, 1]", |file| {
        replace(file, "rewards", &actions());
    });
    check_refused("timeouts has shape []; expected [N] or [N, 1]", |file| {
        replace(file, "timeouts", &ndarray::arr0(true));
    });
    check_refused("actions has 5 rows; expected 6, as many as observations", |file| {
        replace(file, "actions", &Array2::<f32>::zeros((5, 2)));
    });
    check_refused("timeouts has 7 rows; expected 6", |file| {
        replace(file, "timeouts", &Array1::<u8>::zeros(7));
    });
    check_refused("observations has 0 rows; expected at least 1", |file| {
        replace(file, "observations", &Array2::<f32>::zeros((0, 3)));
    });
}

#[test]
fn wrong_types_are_refused() {
    check_refused("actions is of type int64; expected float32 or float64", |file| {
        replace(file, "actions", &Array2::<i64>::zeros((N, 2)));
    });
    check_refused("terminals is of type unicode (var len); expected bool, or", |file| {
        file.unlink("terminals").unwrap();
        file.new_dataset::<VarLenUnicode>().shape(N).create("terminals").unwrap();
    });
}

#[test]
fn wrong_values_are_refused_with_their_place() {
    check_refused("observations holds NaN at row 4, column 1; expected finite", |file| {
        let mut values = observations();
        values[(4, 1)] = f64::NAN;
        values[(5, 0)] = f64::NAN;
        replace(file, "observations", &values);
    });
    check_refused("observations holds inf at row 0, column 2", |file| {
        let mut values = observations();
        // Finite, but not as float32.
        values[(0, 2)] = 1e300;
        replace(file, "observations", &values);
    });
    check_refused("rewards holds -inf at row 5, column 0", |file| {
        let mut values = rewards();
        values[5] = f64::NEG_INFINITY;
        replace(file, "rewards", &values);
    });
    check_refused("actions holds NaN at row 1, column 1; expected finite", |file| {
        let mut values = actions();
        values[(1, 1)] = f64::NAN;
        replace(file, "actions", &values);
    });
    check_refused(
        "actions holds -1.5 at row 3, column 0; expected values within [-1, 1]",
        |file| {
            let mut values = actions();
            values[(3, 0)] = -1.5;
            replace(file, "actions", &values);
        },
    );
    check_refused("terminals holds 2 at row 3; expected 0 or 1", |file| {
        replace(file, "terminals", &(2 * flags(3)));
    });
    check_refused("timeouts holds 0.5 at row 2; expected 0 or 1", |file| {
        replace(file, "timeouts", &flags(2).mapv(|flag| 0.5 * f32::from(flag)));
    });
    check_refused("timeouts holds NaN at row 2; expected 0 or 1", |file| {
        replace(file, "timeouts", &flags(2).mapv(|flag| if flag == 1 { f32::NAN } else { 0.0 }));
    });
}

#[test]
fn a_damaged_bool_is_refused() {
    let pattern = [1, 1, 0, 1, 0, 1];
    let (_folder, path) = file(|file| {
        replace(file, "terminals", &Array1::from_iter(pattern.map(|flag| flag == 1)));
    });
    let mut bytes = fs::read(&path).unwrap();
    let places: Vec<usize> = (0..bytes.len() - N).filter(|&i| bytes[i..i + N] == pattern).collect();
    assert_eq!(places.len(), 1);
    bytes[places[0] + 3] = 7;
    fs::write(&path, bytes).unwrap();
    check_path_refused("terminals holds 7 at row 3; expected 0 or 1", &path);
}

#[test]
fn a_file_that_is_being_written_is_not_called_damaged() {
    let (_folder, path) = file(|_| ());
    let writer = fs::File::open(&path).unwrap();
    writer.lock().unwrap();
    check_path_refused("cannot read the file: ", &path);
    writer.unlock().unwrap();
    assert!(RecordedFile::open(&path).is_ok());
}
