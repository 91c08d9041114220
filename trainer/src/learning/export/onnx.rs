//! ONNX protobufs, as far as policies need them. Field numbers are those of the public `onnx.proto`.

use prost::Message;

use crate::learning::network::NEGATIVE_SLOPE;

/// `AttributeProto.AttributeType.FLOAT`.
const ATTRIBUTE_FLOAT: i32 = 1;
/// `AttributeProto.AttributeType.INT`.
const ATTRIBUTE_INT: i32 = 2;
/// `AttributeProto.AttributeType.INTS`.
const ATTRIBUTE_INTS: i32 = 7;
/// `TensorProto.DataType.INT64`.
const DATA_INT64: i32 = 7;
/// `TensorProto.DataType.FLOAT`.
const DATA_FLOAT: i32 = 1;
/// The version of the file format that came with opset 17.
const IR_VERSION: i64 = 8;
const OPSET_VERSION: i64 = 17;
/// Name of the dynamic dimension.
const BATCH: &str = "N";

#[derive(Clone, PartialEq, Message)]
struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<OperatorSet>,
}

#[derive(Clone, PartialEq, Message)]
struct OperatorSet {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

/// Operations, in an order in which they can be computed.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Graph {
    #[prost(message, repeated, tag = "1")]
    nodes: Vec<Node>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializers: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    inputs: Vec<ValueInfo>,
    #[prost(message, repeated, tag = "12")]
    outputs: Vec<ValueInfo>,
}

#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(string, repeated, tag = "1")]
    inputs: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    outputs: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    op_type: String,
    #[prost(message, repeated, tag = "5")]
    attributes: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(float, tag = "2")]
    float: f32,
    #[prost(int64, tag = "3")]
    int: i64,
    #[prost(int64, repeated, packed = "false", tag = "8")]
    ints: Vec<i64>,
    #[prost(int32, tag = "20")]
    kind: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(int64, repeated, packed = "false", tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    /// Little-endian.
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueInfo {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    kind: Option<Type>,
}

#[derive(Clone, PartialEq, Message)]
struct Type {
    #[prost(message, optional, tag = "1")]
    tensor: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    data_type: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    dims: Vec<Dimension>,
}

#[derive(Clone, PartialEq, Message)]
struct Dimension {
    #[prost(oneof = "DimensionKind", tags = "1, 2")]
    kind: Option<DimensionKind>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum DimensionKind {
    #[prost(int64, tag = "1")]
    Size(i64),
    #[prost(string, tag = "2")]
    Name(String),
}

/// The bytes of the model that `graph` is.
pub(super) fn encode(graph: Graph) -> Vec<u8> {
    let model = Model {
        ir_version: IR_VERSION,
        producer_name: "palr-gym".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        graph: Some(graph),
        opset_import: vec![OperatorSet { domain: String::new(), version: OPSET_VERSION }],
    };
    model.encode_to_vec()
}

impl Graph {
    /// From input `observation` `[N, observation_size]` to `[N, action_size]` each of `action`,
    /// `mean` and `log_std`.
    pub(super) fn of_policy(observation_size: usize, action_size: usize) -> Self {
        Self {
            name: "policy".into(),
            inputs: vec![matrix("observation", observation_size)],
            outputs: ["action", "mean", "log_std"].map(|name| matrix(name, action_size)).to_vec(),
            ..Self::default()
        }
    }

    /// Numbers that the graph holds.
    pub(super) fn constant(&mut self, name: &str, dims: &[i64], values: &[f32]) {
        self.initializers.push(Tensor {
            dims: dims.to_vec(),
            data_type: DATA_FLOAT,
            name: name.to_owned(),
            raw_data: values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        });
    }

    /// Indices that the graph holds, `[length]`.
    pub(super) fn indices(&mut self, name: &str, values: &[i64]) {
        self.initializers.push(Tensor {
            dims: vec![values.len() as i64],
            data_type: DATA_INT64,
            name: name.to_owned(),
            raw_data: values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        });
    }

    /// An operation without attributes.
    pub(super) fn node(&mut self, op_type: &str, inputs: &[&str], output: &str) {
        self.nodes.push(node(op_type, inputs, output));
    }

    /// LeakyReLU.
    pub(super) fn activation(&mut self, input: &str, output: &str) {
        let slope = NEGATIVE_SLOPE as f32;
        let node = node("LeakyRelu", &[input], output);
        self.nodes.push(Node { attributes: vec![float("alpha", slope)], ..node });
    }

    /// Matrices side by side.
    pub(super) fn concat(&mut self, inputs: &[&str], output: &str) {
        let node = node("Concat", inputs, output);
        self.nodes.push(Node { attributes: vec![int("axis", 1)], ..node });
    }

    /// Layer norm over the last axis, of input, gain and shift.
    pub(super) fn layer_norm(&mut self, inputs: &[&str], output: &str, epsilon: f32) {
        let node = node("LayerNormalization", inputs, output);
        let attributes = vec![int("axis", -1), float("epsilon", epsilon)];
        self.nodes.push(Node { attributes, ..node });
    }

    /// The axes in another order.
    pub(super) fn transpose(&mut self, input: &str, output: &str, order: &[i64]) {
        let node = node("Transpose", &[input], output);
        let order = Attribute {
            name: "perm".into(),
            ints: order.to_vec(),
            kind: ATTRIBUTE_INTS,
            ..Attribute::default()
        };
        self.nodes.push(Node { attributes: vec![order], ..node });
    }
}

fn float(name: &str, float: f32) -> Attribute {
    Attribute { name: name.to_owned(), float, kind: ATTRIBUTE_FLOAT, ..Attribute::default() }
}

fn int(name: &str, int: i64) -> Attribute {
    Attribute { name: name.to_owned(), int, kind: ATTRIBUTE_INT, ..Attribute::default() }
}

fn node(op_type: &str, inputs: &[&str], output: &str) -> Node {
    Node {
        inputs: inputs.iter().map(|&input| input.to_owned()).collect(),
        outputs: vec![output.to_owned()],
        name: format!("{op_type}_{output}"),
        op_type: op_type.to_owned(),
        attributes: vec![],
    }
}

/// A float32 input or output, `[N, columns]`.
fn matrix(name: &str, columns: usize) -> ValueInfo {
    let dims = vec![
        Dimension { kind: Some(DimensionKind::Name(BATCH.into())) },
        Dimension { kind: Some(DimensionKind::Size(columns as i64)) },
    ];
    let tensor = TensorType { data_type: DATA_FLOAT, shape: Some(Shape { dims }) };
    ValueInfo { name: name.to_owned(), kind: Some(Type { tensor: Some(tensor) }) }
}
