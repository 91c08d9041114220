//! The policy as an ONNX protobuf. Field numbers are those of the public `onnx.proto`.

use prost::Message;

use crate::learning::error::TrainError;
use crate::learning::export::TrainedPolicy;
use crate::learning::policy_net::{LOG_STD_RANGE, NEGATIVE_SLOPE};

/// `AttributeProto.AttributeType.FLOAT`.
const ATTRIBUTE_FLOAT: i32 = 1;
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

#[derive(Clone, PartialEq, Message)]
struct Graph {
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

/// The bytes of the model.
pub(super) fn encode(policy: &TrainedPolicy) -> Result<Vec<u8>, TrainError> {
    let shape = policy.shape;
    let statistics = &policy.observation_statistics;
    let observation_size = shape.observation_size as i64;
    let mut graph = Graph { name: "policy".into(), ..Graph::default() };
    graph.inputs = vec![matrix("observation", shape.observation_size)];
    graph.outputs =
        ["action", "mean", "log_std"].map(|name| matrix(name, shape.action_size)).to_vec();

    graph.constant("observation_mean", &[observation_size], &statistics.mean);
    graph.constant("observation_std", &[observation_size], &statistics.std);
    graph.node("Sub", &["observation", "observation_mean"], "centered");
    graph.node("Div", &["centered", "observation_std"], "standardized");

    for layer in shape.split(&policy.parameters)? {
        let name = layer.shape.name;
        let weight = format!("{name}.weight");
        let dims = [layer.shape.inputs as i64, layer.shape.outputs as i64];
        graph.constant(&weight, &dims, layer.weight);
        let input = match name {
            "encoder_1" => "standardized",
            "encoder_2" => "encoder_1_active",
            "hidden" => "encoder_2_active",
            _ => "hidden_active",
        };
        // The heads' outputs are the model's; log_std is still to be clamped.
        let output = match name {
            "mean" => "mean".to_owned(),
            _ => format!("{name}_linear"),
        };
        match layer.bias {
            None => graph.node("MatMul", &[input, &weight], &output),
            Some(values) => {
                let bias = format!("{name}.bias");
                graph.constant(&bias, &[dims[1]], values);
                let product = format!("{name}_product");
                graph.node("MatMul", &[input, &weight], &product);
                graph.node("Add", &[&product, &bias], &output);
            }
        }
        if !matches!(name, "mean" | "log_std") {
            graph.activation(&output, &format!("{name}_active"));
        }
    }
    graph.constant("log_std_low", &[], &[LOG_STD_RANGE[0] as f32]);
    graph.constant("log_std_high", &[], &[LOG_STD_RANGE[1] as f32]);
    graph.node("Clip", &["log_std_linear", "log_std_low", "log_std_high"], "log_std");
    graph.node("Tanh", &["mean"], "action");

    let model = Model {
        ir_version: IR_VERSION,
        producer_name: "palr-gym".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        graph: Some(graph),
        opset_import: vec![OperatorSet { domain: String::new(), version: OPSET_VERSION }],
    };
    Ok(model.encode_to_vec())
}

impl Graph {
    fn constant(&mut self, name: &str, dims: &[i64], values: &[f32]) {
        self.initializers.push(Tensor {
            dims: dims.to_vec(),
            data_type: DATA_FLOAT,
            name: name.to_owned(),
            raw_data: values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        });
    }

    fn node(&mut self, op_type: &str, inputs: &[&str], output: &str) {
        self.nodes.push(node(op_type, inputs, output));
    }

    fn activation(&mut self, input: &str, output: &str) {
        let slope = NEGATIVE_SLOPE as f32;
        let alpha = Attribute { name: "alpha".into(), float: slope, kind: ATTRIBUTE_FLOAT };
        let node = node("LeakyRelu", &[input], output);
        self.nodes.push(Node { attributes: vec![alpha], ..node });
    }
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
