//! The policies of all architectures as ONNX graphs.

use crate::learning::algorithms::vib::SPREAD_SHIFT;
use crate::learning::architecture::Kind;
use crate::learning::error::TrainError;
use crate::learning::export::TrainedPolicy;
use crate::learning::export::onnx::{Graph, encode};
use crate::learning::network::{LayerParameters, split};
use crate::learning::policy_net::{Join, LOG_STD_RANGE, REPRESENTATION_SIZE};

/// Name of the standardised observations in every graph.
pub(super) const OBSERVATIONS: &str = "standardized";

/// The bytes of the policy's model.
pub(super) fn model(policy: &TrainedPolicy) -> Result<Vec<u8>, TrainError> {
    let architecture = policy.architecture;
    let (observation_size, frame_size) = (architecture.observation_size, architecture.frame_size);
    let mut graph = Graph::of_policy(observation_size, architecture.action_size);
    let statistics = &policy.observation_statistics;
    graph.constant("observation_mean", &[observation_size as i64], &statistics.mean);
    graph.constant("observation_std", &[observation_size as i64], &statistics.std);
    graph.node("Sub", &["observation", "observation_mean"], "centered");
    graph.node("Div", &["centered", "observation_std"], OBSERVATIONS);

    let networks = policy.networks()?;
    let mut parts = Vec::new();
    for (prefix, layers, parameters) in &networks {
        parts.push((prefix.as_str(), split(layers, parameters)?));
    }
    let join = architecture.policy_shape().join;
    match (architecture.kind, parts.as_slice()) {
        (Kind::Rap, [(prefix, memory), (_, own)]) => {
            let [first, second] = two(memory)?;
            let hidden = graph.linear(prefix, first, OBSERVATIONS);
            let hidden = graph.active(&hidden);
            let memory = graph.linear(prefix, second, &hidden);
            let frame = graph.columns(OBSERVATIONS, observation_size - frame_size, frame_size);
            graph.policy("", own, &frame, Some((&memory, join)))?;
        }
        (Kind::Primenet(_), [(prefix, prime), (_, own)]) => {
            let frame = graph.columns(OBSERVATIONS, observation_size - frame_size, frame_size);
            graph.policy(prefix, prime, &frame, None)?;
            let mean = format!("{prefix}mean");
            graph.node("Tanh", &[&mean], "prime_action");
            graph.policy("", own, OBSERVATIONS, Some(("prime_action", join)))?;
        }
        (Kind::Sampled(samples), [(_, own), (_, noise)]) => {
            graph.sampled(own, noise, samples)?;
        }
        (Kind::Transformer, [(_, own)]) => graph.transformer(own)?,
        (Kind::Plain, [(_, own)]) => graph.policy("", own, OBSERVATIONS, None)?,
        _ => return Err(wrong_parts()),
    }
    graph.node("Tanh", &["mean"], "action");
    Ok(encode(graph))
}

/// The bytes of a policy of layers with ReLU between them: hidden ones, then those of mean and
/// log_std. It takes raw observations.
pub(super) fn relu_model(
    observation_size: usize,
    action_size: usize,
    layers: &[LayerParameters<'_>],
) -> Result<Vec<u8>, TrainError> {
    let [hidden @ .., mean, log_std] = layers else { return Err(wrong_parts()) };
    let mut graph = Graph::of_policy(observation_size, action_size);
    let mut input = "observation".to_owned();
    for layer in hidden {
        let linear = graph.linear("", layer, &input);
        input = format!("{linear}_active");
        graph.node("Relu", &[&linear], &input);
    }
    graph.parameters("", mean);
    graph.apply("", mean, &input, "mean");
    let spread = graph.linear("", log_std, &input);
    graph.clip(&spread, "log_std");
    graph.node("Tanh", &["mean"], "action");
    Ok(encode(graph))
}

/// That the parts are as many as the architecture says is the architecture's own doing.
fn wrong_parts() -> TrainError {
    TrainError::Tensor("a policy's networks are not those of its architecture".into())
}

fn two<'a>(layers: &'a [LayerParameters<'a>]) -> Result<[&'a LayerParameters<'a>; 2], TrainError> {
    match layers {
        [first, second] => Ok([first, second]),
        _ => Err(wrong_parts()),
    }
}

impl Graph {
    /// A layer's constants.
    pub(super) fn parameters(&mut self, prefix: &str, layer: &LayerParameters<'_>) {
        let name = format!("{prefix}{}", layer.shape.name);
        let dims = [layer.shape.inputs as i64, layer.shape.outputs as i64];
        self.constant(&format!("{name}.weight"), &dims, layer.weight);
        if let Some(bias) = layer.bias {
            self.constant(&format!("{name}.bias"), &dims[1..], bias);
        }
    }

    /// A layer with its constants; returns the output's name.
    pub(super) fn linear(
        &mut self,
        prefix: &str,
        layer: &LayerParameters<'_>,
        input: &str,
    ) -> String {
        self.parameters(prefix, layer);
        let output = format!("{prefix}{}_linear", layer.shape.name);
        self.apply(prefix, layer, input, &output);
        output
    }

    /// A layer whose constants are there.
    pub(super) fn apply(
        &mut self,
        prefix: &str,
        layer: &LayerParameters<'_>,
        input: &str,
        output: &str,
    ) {
        let name = format!("{prefix}{}", layer.shape.name);
        let weight = format!("{name}.weight");
        if layer.bias.is_none() {
            return self.node("MatMul", &[input, &weight], output);
        }
        let product = format!("{output}_product");
        self.node("MatMul", &[input, &weight], &product);
        self.node("Add", &[&product, &format!("{name}.bias")], output);
    }

    /// LeakyReLU; returns the output's name.
    fn active(&mut self, input: &str) -> String {
        let output = format!("{input}_active");
        self.activation(input, &output);
        output
    }

    /// `count` columns from `start` on; returns the output's name.
    fn columns(&mut self, input: &str, start: usize, count: usize) -> String {
        self.slice(input, 1, start, count)
    }

    /// `count` entries of an axis from `start` on; returns the output's name.
    pub(super) fn slice(&mut self, input: &str, axis: i64, start: usize, count: usize) -> String {
        let output = format!("{input}_{start}_{count}");
        let [starts, ends, axes] =
            ["starts", "ends", "axes"].map(|name| format!("{output}_{name}"));
        self.indices(&starts, &[start as i64]);
        self.indices(&ends, &[(start + count) as i64]);
        self.indices(&axes, &[axis]);
        self.node("Slice", &[input, &starts, &ends, &axes], &output);
        output
    }

    /// A policy network, with what joins it; makes `<prefix>mean` and `<prefix>log_std`.
    fn policy(
        &mut self,
        prefix: &str,
        layers: &[LayerParameters<'_>],
        observations: &str,
        joined: Option<(&str, Join)>,
    ) -> Result<(), TrainError> {
        let [encoder_1, encoder_2, hidden, mean, log_std] = layers else {
            return Err(wrong_parts());
        };
        let (mut input, mut representation_join, mut hidden_join) = (None, None, None);
        match joined {
            Some((name, Join::Input(_))) => input = Some(name),
            Some((name, Join::Representation(_))) => representation_join = Some(name),
            Some((name, Join::Hidden(_))) => hidden_join = Some(name),
            Some((_, Join::Nowhere)) | None => {}
        }
        let input = self.beside(input, observations);
        let encoded = self.linear(prefix, encoder_1, &input);
        let encoded = self.active(&encoded);
        let representation = self.linear(prefix, encoder_2, &encoded);
        let representation = self.beside(representation_join, &representation);
        let active = self.active(&representation);
        let last = self.linear(prefix, hidden, &active);
        let last = self.active(&last);
        let last = self.beside(hidden_join, &last);
        self.parameters(prefix, mean);
        self.apply(prefix, mean, &last, &format!("{prefix}mean"));
        let spread = self.linear(prefix, log_std, &last);
        self.clip(&spread, &format!("{prefix}log_std"));
        Ok(())
    }

    /// `joined` and then `own`, if there is something to join.
    fn beside(&mut self, joined: Option<&str>, own: &str) -> String {
        let Some(joined) = joined else { return own.to_owned() };
        let output = format!("{own}_joined");
        self.concat(&[joined, own], &output);
        output
    }

    pub(super) fn clip(&mut self, input: &str, output: &str) {
        let [low, high] = ["low", "high"].map(|end| format!("{output}_{end}"));
        self.constant(&low, &[], &[LOG_STD_RANGE[0] as f32]);
        self.constant(&high, &[], &[LOG_STD_RANGE[1] as f32]);
        self.node("Clip", &[input, &low, &high], output);
    }

    /// VIB's policy, averaged over fixed samples of its bottleneck.
    fn sampled(
        &mut self,
        layers: &[LayerParameters<'_>],
        noise: &[LayerParameters<'_>],
        samples: usize,
    ) -> Result<(), TrainError> {
        let ([encoder_1, encoder_2, hidden, mean, log_std], [noise]) = (layers, noise) else {
            return Err(wrong_parts());
        };
        let encoded = self.linear("", encoder_1, OBSERVATIONS);
        let encoded = self.active(&encoded);
        let encoded = self.linear("", encoder_2, &encoded);
        let center = self.columns(&encoded, 0, REPRESENTATION_SIZE);
        let spread = self.columns(&encoded, REPRESENTATION_SIZE, REPRESENTATION_SIZE);
        self.constant("spread_shift", &[], &[SPREAD_SHIFT as f32]);
        self.node("Sub", &[&spread, "spread_shift"], "spread_shifted");
        self.node("Softplus", &["spread_shifted"], "spread");
        [hidden, mean, log_std].into_iter().for_each(|layer| self.parameters("", layer));
        let rows = noise.weight.chunks_exact(REPRESENTATION_SIZE);
        for (at, row) in rows.enumerate() {
            let name = |part: &str| format!("sample_{at}_{part}");
            self.constant(&name("noise"), &[REPRESENTATION_SIZE as i64], row);
            self.node("Mul", &["spread", &name("noise")], &name("offset"));
            self.node("Add", &[&center, &name("offset")], &name("representation"));
            let active = self.active(&name("representation"));
            self.apply("", hidden, &active, &name("hidden"));
            let last = self.active(&name("hidden"));
            self.apply("", mean, &last, &name("mean"));
            self.apply("", log_std, &last, &name("log_std_linear"));
            self.clip(&name("log_std_linear"), &name("log_std"));
        }
        for output in ["mean", "log_std"] {
            let names: Vec<String> =
                (0..samples).map(|at| format!("sample_{at}_{output}")).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            self.node("Mean", &names, output);
        }
        Ok(())
    }
}
