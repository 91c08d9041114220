use palr_gym_onnx::OnnxError;
use prost::Message;

use super::*;

const SHIPPED: &[u8] = include_bytes!("../../../../scenes/features/lane-compact-resnet.onnx");

/// The parts of `onnx.proto` that the tests change; what they do not know is lost, so models are
/// put together by appending.
#[derive(Clone, PartialEq, Message)]
struct Appended {
    #[prost(message, repeated, tag = "14")]
    metadata: Vec<Entry>,
}

#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

/// The shipped model with other metadata: of an entry that comes twice, the last counts.
fn with_metadata(key: &str, value: &str) -> Vec<u8> {
    let entry = Entry { key: key.into(), value: value.into() };
    let appended = Appended { metadata: vec![entry] }.encode_to_vec();
    [SHIPPED, &appended].concat()
}

fn load(model: &[u8]) -> Result<Extractor, VisionError> {
    Extractor::load(model, ExtractorLimits::default())
}

fn noise(count: usize) -> Vec<u8> {
    (0..count * 48 * 48 * 3).map(|i| ((i * i * 31 + i * 7) % 251) as u8).collect()
}

#[test]
fn features_do_not_depend_on_the_company_of_a_picture_or_on_the_thread() {
    let extractor = load(SHIPPED).unwrap();
    assert_eq!(extractor.picture_size_px(), (48, 48));
    let pictures = noise(5);
    let mut together = Vec::new();
    extractor.extract(&pictures, 5, &mut together).unwrap();
    assert_eq!(together.len(), 5 * extractor.size());
    std::thread::scope(|scope| {
        for (i, picture) in pictures.chunks(48 * 48 * 3).enumerate() {
            let (extractor, together) = (&extractor, &together);
            scope.spawn(move || {
                let mut alone = Vec::new();
                extractor.extract(picture, 1, &mut alone).unwrap();
                assert_eq!(alone, together[i * alone.len()..(i + 1) * alone.len()]);
            });
        }
    });
}

#[test]
fn models_outside_the_contract_are_refused_with_what_was_wanted() {
    let refusal = |model: &[u8]| load(model).err().map(|error| error.to_string());
    let check = |model: &[u8], expected: &str| {
        let error = refusal(model).unwrap_or_default();
        assert!(error.contains(expected), "{error} does not contain {expected}");
    };
    check(b"not onnx", "no ONNX model");
    check(&SHIPPED[..SHIPPED.len() / 2], "no ONNX model");
    check(
        &with_metadata("palr_gym.size", "64 64"),
        "float32 [N, 3, 48, 48]; expected float32 [N, 3, 64, 64]",
    );
    check(&with_metadata("palr_gym.size", "0 48"), "pictures of 0 x 48 pixels");
    check(&with_metadata("palr_gym.size", "10000 48"), "pictures of 10000 x 48 pixels");
    check(&with_metadata("palr_gym.std", "0 1 1"), "expected three numbers above 0");
    // 255 of them overflow a float32.
    check(&with_metadata("palr_gym.scale", "1e38"), "expected finite numbers");
    let policy = include_bytes!("../../../../scenes/experts/hopper.onnx");
    check(policy, "palr_gym.contract = nothing; expected image-features-1");
    let limits = ExtractorLimits { max_bytes: 1000, ..ExtractorLimits::default() };
    let error = Extractor::load(SHIPPED, limits).unwrap_err();
    assert!(matches!(error, VisionError::Model(OnnxError::TooLarge { .. })), "{error}");
    let error = Extractor::read("/no/such/file.onnx".as_ref(), limits).unwrap_err().to_string();
    assert!(error.contains("/no/such/file.onnx"), "{error}");
}

#[test]
fn weights_in_another_file_are_refused() {
    #[derive(Clone, PartialEq, Message)]
    struct Model {
        #[prost(message, optional, tag = "7")]
        graph: Option<Graph>,
    }
    #[derive(Clone, PartialEq, Message)]
    struct Graph {
        #[prost(message, repeated, tag = "5")]
        initializers: Vec<Tensor>,
    }
    #[derive(Clone, PartialEq, Message)]
    struct Tensor {
        #[prost(string, tag = "8")]
        name: String,
        #[prost(int32, tag = "14")]
        data_location: i32,
    }
    let tensor = Tensor { name: "elsewhere".into(), data_location: 1 };
    let appended = Model { graph: Some(Graph { initializers: vec![tensor] }) }.encode_to_vec();
    // Messages that come twice are merged.
    let error = load(&[SHIPPED, &appended].concat()).unwrap_err().to_string();
    assert!(error.contains("keeps tensor \"elsewhere\" in an external file"), "{error}");
}

#[test]
fn another_number_of_bytes_than_pictures_have_is_refused() {
    let extractor = load(SHIPPED).unwrap();
    for (bytes, count) in [(48 * 48 * 3, 2), (10, 1), (0, 0)] {
        let error = extractor.extract(&vec![0; bytes], count, &mut Vec::new()).unwrap_err();
        assert!(matches!(error, VisionError::Pictures { .. }), "{error}");
    }
}
