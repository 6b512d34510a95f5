//! A variable type and a measurement of your own in everything that a map goes through: added,
//! optimized, removed, saved as plain data and read back.
//!
//!     cargo run -p evergraph --example own_types
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::collections::HashMap;
use std::error::Error;

use evergraph::factors::LocalJacobian;
use evergraph::factors::autodiff::{AutoDiff, Number, Residual, Transform2, Variable, wrap_angle};
use evergraph::factors::catalogue::{
    Catalogue, DataError, FactorData, StoredResidual, StoredVariable, ValueData,
};
use evergraph::prelude::*;
use evergraph::removal::Removal;
use serde::{Deserialize, Serialize};

/// Metres driven per metre that the wheels count: a positive number, which worn tyres change.
///
/// A step multiplies it, `x exp(d)`, so that no step makes it negative.
#[derive(Clone, Debug, PartialEq)]
pub struct WheelScale(f64);

impl Manifold for WheelScale {
    const NAME: &'static str = "example.WheelScale";
    const COMPONENTS: &'static [&'static str] = &["log scale"];

    fn dim(&self) -> usize {
        1
    }

    fn storage_len(&self) -> usize {
        1
    }

    fn store(&self, out: &mut [f64]) {
        out[0] = self.0;
    }

    fn load(storage: &[f64]) -> Self {
        Self(storage[0])
    }

    fn retract(&self, delta: &[f64]) -> Self {
        Self(self.0 * delta[0].exp())
    }

    fn local(&self, other: &Self, out: &mut [f64]) {
        out[0] = (other.0 / self.0).ln();
    }
}

/// For priors.
impl LocalJacobian for WheelScale {
    fn local_jacobian(&self, _: &[f64], out: &mut [f64]) {
        out[0] = 1.0;
    }
}

/// For measurements without a derivative by hand.
impl Variable for WheelScale {
    type Manifold = Self;
    type Lifted<T: Number> = T;
    const DIM: usize = 1;

    fn lift<T: Number>(storage: &[f64], tangent: &[T]) -> T {
        tangent[0].exp() * storage[0]
    }
}

/// For plain data.
impl StoredVariable for WheelScale {
    const LENGTH: Option<usize> = Some(1);

    fn check(numbers: &[f64]) -> Result<(), String> {
        if numbers[0] > 0.0 { Ok(()) } else { Err("a scale is positive".into()) }
    }
}

/// Counts of the wheels from one pose to the next.
#[derive(Debug)]
pub struct Odometer {
    /// Metres, as counted.
    counted: f64,
    /// Radians.
    turned: f64,
}

impl Residual<3> for Odometer {
    type Variables = (Pose2, Pose2, WheelScale);
    const NAME: &'static str = "example.Odometer";

    fn evaluate<T: Number>(&self, (from, to, scale): (Transform2<T>, Transform2<T>, T)) -> [T; 3] {
        let step = from.inverse().compose(&to);
        let way = step.translation();
        [way.x - scale * self.counted, way.y, wrap_angle(step.heading() - self.turned)]
    }
}

impl StoredResidual<3> for Odometer {
    fn numbers(&self) -> Vec<f64> {
        vec![self.counted, self.turned]
    }

    fn from_numbers(numbers: &[f64]) -> Result<Self, DataError> {
        match *numbers {
            [counted, turned] => Ok(Self { counted, turned }),
            _ => Err(DataError::Numbers { expected: 2, actual: numbers.len() }),
        }
    }
}

/// All types of the library and the two above.
pub fn catalogue() -> Result<Catalogue, Box<dyn Error>> {
    let mut catalogue = Catalogue::standard();
    catalogue.register_variable::<WheelScale>()?;
    catalogue.register_factor::<Prior<WheelScale>>()?;
    catalogue.register_factor::<AutoDiff<Odometer, 3>>()?;
    Ok(catalogue)
}

/// A map as plain data.
#[derive(Debug, Serialize, Deserialize)]
pub struct SavedMap {
    variables: Vec<(VariableId, ValueData)>,
    factors: Vec<FactorData>,
}

impl SavedMap {
    /// The factors of a smoother and the estimates of its variables.
    pub fn of(smoother: &Smoother, catalogue: &Catalogue) -> Result<Self, Box<dyn Error>> {
        let graph = smoother.graph();
        let mut variables = Vec::new();
        for id in graph.variables() {
            variables.push((id, catalogue.to_value_data(&smoother.estimate_value(id)?)?));
        }
        let factors = graph.factors().map(|(_, factor)| catalogue.to_data(factor));
        Ok(Self { variables, factors: factors.collect::<Result<_, _>>()? })
    }

    /// A smoother with this map, and the new id of each variable by its old one.
    pub fn open(
        self,
        catalogue: &Catalogue,
    ) -> Result<(Smoother, HashMap<VariableId, VariableId>), Box<dyn Error>> {
        let mut smoother = Smoother::new(Settings::default())?;
        let mut change = smoother.change();
        let mut new_ids = HashMap::new();
        for (id, value) in &self.variables {
            new_ids.insert(*id, change.add_value(catalogue.to_value(value)?));
        }
        for mut data in self.factors {
            for end in &mut data.ends {
                *end = *new_ids.get(end).ok_or("a factor is on a variable that was not saved")?;
            }
            change.add_shared_factor(catalogue.to_factor(&data)?);
        }
        smoother.apply(change)?;
        Ok((smoother, new_ids))
    }
}

/// The poses of a drive, and the scales of its two sets of tyres.
pub type Driven = (Vec<Key<Pose2>>, [Key<WheelScale>; 2]);

/// Thirty metres with one set of tyres and thirty with another.
pub fn drive(smoother: &mut Smoother) -> Result<Driven, Box<dyn Error>> {
    let wheels = Noise::from_sigmas(&[0.02, 0.02, 0.005])?;
    let receiver = Noise::isotropic(2, 0.05)?;
    let true_scales = [1.04, 0.97];

    let mut change = smoother.change();
    let start = change.add_variable(&Pose2::identity());
    change.add_factor(Prior::new(start, Pose2::identity(), Noise::isotropic(3, 0.01)?)?);
    let scales = [0, 1].map(|_| change.add_variable(&WheelScale(1.0)));
    for scale in scales {
        change.add_factor(Prior::new(scale, WheelScale(1.0), Noise::isotropic(1, 0.1)?)?);
    }
    smoother.apply(change)?;

    let mut poses = vec![start];
    let mut truth = Pose2::identity();
    for k in 1..=60 {
        let tyres = if k <= 30 { 0 } else { 1 };
        let turned = 0.05 * f64::from(k % 7 - 3);
        truth = truth * Pose2::new(1.0, 0.0, turned);
        let last = poses[poses.len() - 1];
        let mut change = smoother.change();
        let guess = smoother.estimate(last)? * Pose2::new(1.0, 0.0, turned);
        let pose = change.add_variable(&guess);
        let seen = Odometer { counted: 1.0 / true_scales[tyres], turned };
        change.add_factor(AutoDiff::new((last, pose, scales[tyres]), seen, wheels.clone())?);
        if k % 10 == 0 {
            change.add_factor(GpsPosition2::new(pose, truth.translation(), receiver.clone())?);
        }
        smoother.apply(change)?;
        poses.push(pose);
    }
    smoother.optimize(&BatchSettings::default())?;
    Ok((poses, scales))
}

/// Removes every other pose of the first forty metres, and the scale of the old tyres, by generic
/// linear constraints.
pub fn thin_out(
    smoother: &mut Smoother,
    poses: &[Key<Pose2>],
    old_tyres: Key<WheelScale>,
) -> Result<(), Box<dyn Error>> {
    let every_other = poses[..=40].iter().skip(1).step_by(2).map(|pose| pose.id());
    for node in every_other.chain([old_tyres.id()]) {
        let plan = Removal::new(smoother.graph(), &*smoother).plan(node)?;
        smoother.apply(plan.into_change())?;
    }
    smoother.optimize(&BatchSettings::default())?;
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut smoother = Smoother::new(Settings::default())?;
    let (poses, [old_tyres, new_tyres]) = drive(&mut smoother)?;
    let last = poses[poses.len() - 1];
    println!(
        "old tyres: {:.4}, new tyres: {:.4}",
        smoother.estimate(old_tyres)?.0,
        smoother.estimate(new_tyres)?.0
    );
    println!("last pose: {:?}", smoother.estimate(last)?);

    thin_out(&mut smoother, &poses, old_tyres)?;
    let graph = smoother.graph();
    println!(
        "after removal: {} variables, {} factors",
        graph.variables().count(),
        graph.factors().count()
    );
    println!("last pose: {:?}", smoother.estimate(last)?);

    let catalogue = catalogue()?;
    let text = serde_json::to_string(&SavedMap::of(&smoother, &catalogue)?)?;
    println!("saved in {} bytes", text.len());
    let (mut opened, new_ids) = serde_json::from_str::<SavedMap>(&text)?.open(&catalogue)?;
    opened.optimize(&BatchSettings::default())?;
    let again = opened.estimate_value(new_ids[&last.id()])?;
    println!("last pose: {:?}", again.get::<Pose2>().ok_or("it was a pose")?);
    Ok(())
}
