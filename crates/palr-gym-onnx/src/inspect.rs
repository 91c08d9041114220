//! What is checked in a model's bytes before ONNX Runtime sees them.
//!
//! ONNX Runtime would open files that a model names as the home of its weights. A stranger's model
//! must not make the server read files, so such models are refused here. Only the fields that
//! matter for this are decoded; their numbers are those of the public `onnx.proto`.

use std::collections::BTreeMap;

use prost::Message;

use crate::error::OnnxError;

#[derive(Clone, PartialEq, Message)]
struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "14")]
    metadata: Vec<Entry>,
    #[prost(message, repeated, tag = "25")]
    functions: Vec<Function>,
}

#[derive(Clone, PartialEq, Message)]
struct Function {
    #[prost(message, repeated, tag = "7")]
    nodes: Vec<Node>,
}

#[derive(Clone, PartialEq, Message)]
struct Graph {
    #[prost(message, repeated, tag = "1")]
    nodes: Vec<Node>,
    #[prost(message, repeated, tag = "5")]
    initializers: Vec<Tensor>,
    #[prost(message, repeated, tag = "15")]
    sparse_initializers: Vec<SparseTensor>,
}

#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(message, repeated, tag = "5")]
    attributes: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(message, optional, tag = "5")]
    tensor: Option<Tensor>,
    #[prost(message, optional, tag = "6")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "10")]
    tensors: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    graphs: Vec<Graph>,
    #[prost(message, optional, tag = "22")]
    sparse_tensor: Option<SparseTensor>,
    #[prost(message, repeated, tag = "23")]
    sparse_tensors: Vec<SparseTensor>,
}

#[derive(Clone, PartialEq, Message)]
struct SparseTensor {
    #[prost(message, optional, tag = "1")]
    values: Option<Tensor>,
    #[prost(message, optional, tag = "2")]
    indices: Option<Tensor>,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(string, tag = "8")]
    name: String,
    #[prost(message, repeated, tag = "13")]
    external_data: Vec<Entry>,
    /// 0: in the model, 1: in another file.
    #[prost(int32, tag = "14")]
    data_location: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

/// Refuses bytes that are no ONNX model, and models whose weights lie outside of it. Returns the
/// model's metadata.
///
/// # Errors
/// [`OnnxError::NotOnnx`] or [`OnnxError::ExternalData`].
pub fn inspect(model: &[u8]) -> Result<BTreeMap<String, String>, OnnxError> {
    let model = Model::decode(model)
        .map_err(|error| OnnxError::NotOnnx { message: format!("not a protobuf: {error}") })?;
    let Some(graph) = &model.graph else {
        return Err(OnnxError::NotOnnx { message: "it holds no graph".into() });
    };
    let nodes = model.functions.iter().flat_map(|function| &function.nodes);
    check_graph(graph)
        .and_then(|()| check_nodes(nodes))
        .map_err(|tensor| OnnxError::ExternalData { tensor: tensor.name.clone() })?;
    Ok(model.metadata.into_iter().map(|entry| (entry.key, entry.value)).collect())
}

/// The first offending tensor is the error. Recursion is as deep as the protobuf, which the
/// decoder limits.
fn check_graph(graph: &Graph) -> Result<(), &Tensor> {
    graph.initializers.iter().try_for_each(check_tensor)?;
    graph.sparse_initializers.iter().try_for_each(check_sparse)?;
    check_nodes(&graph.nodes)
}

fn check_nodes<'a>(nodes: impl IntoIterator<Item = &'a Node>) -> Result<(), &'a Tensor> {
    for attribute in nodes.into_iter().flat_map(|node| &node.attributes) {
        attribute.tensor.iter().chain(&attribute.tensors).try_for_each(check_tensor)?;
        attribute
            .sparse_tensor
            .iter()
            .chain(&attribute.sparse_tensors)
            .try_for_each(check_sparse)?;
        attribute.graph.iter().chain(&attribute.graphs).try_for_each(check_graph)?;
    }
    Ok(())
}

fn check_sparse(tensor: &SparseTensor) -> Result<(), &Tensor> {
    tensor.values.iter().chain(&tensor.indices).try_for_each(check_tensor)
}

fn check_tensor(tensor: &Tensor) -> Result<(), &Tensor> {
    if tensor.data_location != 0 || !tensor.external_data.is_empty() { Err(tensor) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn external() -> Tensor {
        Tensor { name: "w".into(), data_location: 1, ..Tensor::default() }
    }

    fn check(graph: Graph, is_refused: bool) {
        let model = Model { ir_version: 9, graph: Some(graph), ..Model::default() };
        let result = inspect(&model.encode_to_vec());
        assert_eq!(matches!(result, Err(OnnxError::ExternalData { .. })), is_refused, "{result:?}");
    }

    fn node(attribute: Attribute) -> Graph {
        Graph { nodes: vec![Node { attributes: vec![attribute] }], ..Graph::default() }
    }

    #[test]
    fn external_tensors_are_found_wherever_they_hide() {
        check(Graph::default(), false);
        check(Graph { initializers: vec![Tensor::default()], ..Graph::default() }, false);
        check(Graph { initializers: vec![external()], ..Graph::default() }, true);
        let listed = Tensor { external_data: vec![Entry::default()], ..Tensor::default() };
        check(Graph { initializers: vec![listed], ..Graph::default() }, true);
        check(node(Attribute { tensor: Some(external()), ..Attribute::default() }), true);
        check(node(Attribute { tensors: vec![external()], ..Attribute::default() }), true);
        let inner = Graph { initializers: vec![external()], ..Graph::default() };
        check(node(Attribute { graph: Some(inner.clone()), ..Attribute::default() }), true);
        check(node(Attribute { graphs: vec![inner], ..Attribute::default() }), true);
        let sparse = SparseTensor { values: Some(external()), indices: None };
        check(Graph { sparse_initializers: vec![sparse], ..Graph::default() }, true);
    }

    #[test]
    fn bytes_that_are_no_model_are_refused() {
        for bytes in [&b""[..], b"not onnx at all", &[0xff; 64]] {
            assert!(matches!(inspect(bytes), Err(OnnxError::NotOnnx { .. })));
        }
    }
}
