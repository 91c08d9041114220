//! A model of any contract: checked, opened, and run under watch.

use std::collections::BTreeMap;
use std::time::Duration;

use ort::session::builder::GraphOptimizationLevel;
use ort::session::{Session, SessionOutputs};
use ort::value::{Outlet, TensorElementType, TensorRef, ValueType};

use crate::error::OnnxError;
use crate::inspect::inspect;
use crate::runtime::environment;
use crate::watchdog::Watchdog;

/// How much a model may use.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Bytes of the model.
    pub max_bytes: usize,
    /// Wall-clock time of one inference.
    pub max_inference: Duration,
}

/// A model that runs on the calling thread.
pub struct Model {
    session: Session,
    watchdog: Watchdog,
    metadata: BTreeMap<String, String>,
}

/// What a run returned.
pub struct Outputs<'a>(SessionOutputs<'a>);

impl Model {
    /// Checks `model` as far as any contract asks for it, and opens it.
    ///
    /// # Errors
    /// [`OnnxError::TooLarge`], [`OnnxError::NotOnnx`], [`OnnxError::ExternalData`] or
    /// [`OnnxError::RuntimeMissing`].
    pub fn open(model: &[u8], limits: Limits) -> Result<Self, OnnxError> {
        let Limits { max_bytes, max_inference } = limits;
        if model.len() > max_bytes {
            return Err(OnnxError::TooLarge { got: model.len(), limit: max_bytes });
        }
        let metadata = inspect(model)?;
        let session = open(model)?;
        let watchdog = Watchdog::new(max_inference)
            .map_err(|error| OnnxError::NotOnnx { message: error.to_string() })?;
        Ok(Self { session, watchdog, metadata })
    }

    /// What the model says of itself beyond its graph.
    #[must_use]
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Its inputs, in order.
    #[must_use]
    pub fn inputs(&self) -> &[Outlet] {
        self.session.inputs()
    }

    /// Names of its outputs, in order.
    #[must_use]
    pub fn output_names(&self) -> Vec<String> {
        self.session.outputs().iter().map(|output| output.name().to_owned()).collect()
    }

    /// Runs it on its only input, `values` of `shape`, whose first dimension is the batch, and has
    /// `read` look at what comes out.
    ///
    /// # Errors
    /// [`OnnxError::Failed`], [`OnnxError::TooSlow`], or what `read` finds wrong.
    pub fn run<R>(
        &mut self,
        shape: &[usize],
        values: &[f32],
        read: impl FnOnce(&Outputs<'_>) -> Result<R, OnnxError>,
    ) -> Result<R, OnnxError> {
        let batch = shape.first().copied().unwrap_or(0);
        let failed = |error: ort::Error| OnnxError::Failed { batch, message: error.to_string() };
        let input = TensorRef::from_array_view((shape, values)).map_err(failed)?;
        let (options, watch) = self.watchdog.watch();
        match self.session.run_with_options(ort::inputs![input], &*options) {
            Ok(outputs) => read(&Outputs(outputs)),
            Err(_) if watch.is_overdue() => {
                Err(OnnxError::TooSlow { limit: self.watchdog.limit(), batch })
            }
            Err(error) => Err(failed(error)),
        }
    }
}

impl Outputs<'_> {
    /// The output `name`, `[batch, columns]`; every number is finite.
    ///
    /// # Errors
    /// [`OnnxError::Shape`] or [`OnnxError::NotFinite`].
    pub fn matrix(&self, name: &str, batch: usize, columns: usize) -> Result<Vec<f32>, OnnxError> {
        let want = [batch as i64, columns as i64];
        let wrong = |got: String| OnnxError::Shape {
            what: format!("output {name:?}"),
            got,
            want: format!("float32 {want:?} for a batch of {batch}"),
        };
        let value = self.0.get(name).ok_or_else(|| wrong("missing".into()))?;
        let (shape, values) =
            value.try_extract_tensor::<f32>().map_err(|_| wrong(value.dtype().to_string()))?;
        if shape[..] != want {
            return Err(wrong(format!("float32 {:?}", &shape[..])));
        }
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(values.to_vec()),
            Some(position) => Err(OnnxError::NotFinite {
                output: name.to_owned(),
                row: position / columns,
                index: position % columns,
                got: values[position],
            }),
        }
    }

    /// Columns of the output `name`, if it is a float32 matrix.
    #[must_use]
    pub fn columns(&self, name: &str) -> Option<usize> {
        let (shape, _) = self.0.get(name)?.try_extract_tensor::<f32>().ok()?;
        match shape[..] {
            [_, columns] => usize::try_from(columns).ok(),
            _ => None,
        }
    }
}

/// Type and shape of an input, for people.
#[must_use]
pub fn describe(input: &Outlet) -> String {
    match input.dtype() {
        ValueType::Tensor { ty, shape, .. } => {
            let sizes: Vec<String> = shape
                .iter()
                .map(|&size| if size == -1 { "N".into() } else { size.to_string() })
                .collect();
            let dtype = match ty {
                TensorElementType::Float32 => "float32".to_owned(),
                other => other.to_string(),
            };
            format!("{dtype} [{}]", sizes.join(", "))
        }
        other => other.to_string(),
    }
}

fn open(model: &[u8]) -> Result<Session, OnnxError> {
    let environment = environment()?;
    let not_onnx = |message: String| OnnxError::NotOnnx { message };
    // One thread a session: batching across environments uses cores better than threads inside an
    // operator.
    Session::builder(environment)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_intra_threads(1)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_inter_threads(1)
        .map_err(|error| not_onnx(error.to_string()))?
        .with_optimization_level(GraphOptimizationLevel::All)
        .map_err(|error| not_onnx(error.to_string()))?
        .commit_from_memory(model)
        .map_err(|error| not_onnx(error.to_string()))
}
