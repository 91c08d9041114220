//! Where a step's M comes from, and the regulariser made of it.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use burn::tensor::Tensor;

use crate::learning::config::{TrainConfig, WeightsMode};
use crate::learning::context::rows;
use crate::learning::data::TrainingSet;
use crate::learning::error::TrainError;
use crate::learning::kernel::hscic_gradient;
use crate::learning::metrics::kernels;
use crate::learning::network::{tensor, values};
use crate::learning::streams::Purpose;
use crate::learning::weights::{PackedWeights, WeightMatrix};

/// Everything that M follows from.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    actions: u32,
    batch_seed: u64,
    purpose: u32,
    index: u64,
    batch: usize,
    is_standardized: bool,
    ridge: u64,
    bandwidth_sq: u64,
}

#[derive(Debug, Default)]
struct Store {
    /// The newest, oldest first: of this step and of the next.
    recent: VecDeque<(Key, Arc<WeightMatrix>)>,
    /// Those of pools, each computed when it is first needed.
    pool: HashMap<Key, PackedWeights>,
}

/// How many Ms are kept besides those of a pool.
const RECENT: usize = 2;

impl Store {
    fn find(&self, key: &Key) -> Option<Arc<WeightMatrix>> {
        let found = self.recent.iter().find(|(other, _)| other == key);
        found.map(|(_, weights)| Arc::clone(weights))
    }

    fn put(&mut self, key: Key, weights: Arc<WeightMatrix>) {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back((key, weights));
    }
}

/// The Ms that were computed, for the runs that share them: M follows from actions and batches, so
/// that runs with one stream of batches need one M a step.
#[derive(Debug, Clone, Default)]
pub struct SharedWeights(Arc<Mutex<Store>>);

impl SharedWeights {
    fn get(
        &self,
        key: Key,
        compute: impl FnOnce() -> Result<WeightMatrix, TrainError>,
    ) -> Result<Arc<WeightMatrix>, TrainError> {
        let is_pooled = key.purpose == Purpose::PoolBatch as u32;
        let packed = {
            let mut store = self.lock();
            if let Some(weights) = store.find(&key) {
                return Ok(weights);
            }
            store.pool.remove(&key)
        };
        // Nobody waits for the lock meanwhile.
        let weights = if is_pooled {
            // Through half precision also when it was just computed: a resumed run sees it so.
            let packed = match packed {
                Some(packed) => packed,
                None => compute()?.pack(),
            };
            let weights = packed.unpack();
            self.lock().pool.insert(key.clone(), packed);
            weights
        } else {
            compute()?
        };
        let weights = Arc::new(weights);
        self.lock().put(key, Arc::clone(&weights));
        Ok(weights)
    }

    fn lock(&self) -> MutexGuard<'_, Store> {
        // A store that a panic left behind is whole: entries are made before they are put.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// M of a step, and the rows that it is of.
#[derive(Debug, Clone)]
pub struct StepWeights {
    /// M.
    pub weights: Arc<WeightMatrix>,
    /// Standardised observations of its rows, `[n, observation_size]`; none if they are the step's.
    pub observations: Option<Vec<f32>>,
}

/// Where a run has its Ms from.
#[derive(Debug, Clone)]
pub struct WeightSource<'a> {
    config: &'a TrainConfig,
    data: &'a TrainingSet,
    actions_fingerprint: u32,
    shared: SharedWeights,
}

impl<'a> WeightSource<'a> {
    /// `shared` changes no bits.
    #[must_use]
    pub fn new(config: &'a TrainConfig, data: &'a TrainingSet, shared: SharedWeights) -> Self {
        Self { config, data, actions_fingerprint: data.actions_fingerprint(), shared }
    }

    /// M of step number `index`, from 0.
    ///
    /// # Errors
    /// [`TrainError::Singular`].
    pub fn of_step(&self, index: u64) -> Result<StepWeights, TrainError> {
        match self.config.palr.weights {
            WeightsMode::Exact => {
                let weights = self.of_rows(Purpose::Batch, index)?;
                Ok(StepWeights { weights, observations: None })
            }
            WeightsMode::Pool => {
                let entry = index % self.config.palr.pool_size as u64;
                let weights = self.of_rows(Purpose::PoolBatch, entry)?;
                let rows = rows(self.config, self.data, Purpose::PoolBatch, entry);
                let observations = Some(self.data.batch(&rows).observations);
                Ok(StepWeights { weights, observations })
            }
        }
    }

    fn of_rows(&self, purpose: Purpose, index: u64) -> Result<Arc<WeightMatrix>, TrainError> {
        let palr = &self.config.palr;
        let key = Key {
            actions: self.actions_fingerprint,
            batch_seed: self.config.batch_seed(),
            purpose: purpose as u32,
            index,
            batch: self.config.batch,
            is_standardized: palr.standardize_actions,
            ridge: palr.ridge.to_bits(),
            bandwidth_sq: palr.bandwidth_sq.to_bits(),
        };
        self.shared.get(key, || {
            let rows = rows(self.config, self.data, purpose, index);
            let (past, given) = self.data.hscic_actions(&rows, palr.standardize_actions);
            WeightMatrix::new(&past, &given, self.data.action_size(), kernels(self.config))
        })
    }
}

/// An M that is not needed yet.
#[derive(Debug)]
pub(crate) struct Ahead<'a> {
    source: WeightSource<'a>,
    index: u64,
}

impl<'a> Ahead<'a> {
    /// Of step number `index`, from 0; none where it is not worth it.
    pub(crate) fn new(source: &WeightSource<'a>, index: u64) -> Option<Self> {
        let is_exact = source.config.palr.weights == WeightsMode::Exact;
        is_exact.then(|| Self { source: source.clone(), index })
    }

    /// Leaves it where the step finds it.
    pub(crate) fn compute(self) {
        // What is wrong with it is told when it is needed.
        let _ = self.source.of_step(self.index);
    }
}

/// A scalar with the gradient of `factor` · HSCIC of `samples`, `[n, d]`, and HSCIC itself.
///
/// The scalar is `factor Σ X ∘ D` with D, the derivative of HSCIC by X, held constant: autodiff
/// then carries D to the parameters and never sees an n × n matrix.
///
/// # Errors
/// [`TrainError::Tensor`].
pub fn surrogate(
    samples: Tensor<2>,
    weights: &WeightMatrix,
    factor: f64,
    bandwidth_sq: f64,
) -> Result<(Tensor<1>, f64), TrainError> {
    let [_, width] = samples.dims();
    let device = samples.device();
    let hscic = hscic_gradient(&values(samples.clone().inner())?, width, weights, bandwidth_sq);
    let derivative = tensor(hscic.gradient, width, &device);
    Ok(((samples * derivative).sum().mul_scalar(factor), hscic.value))
}
