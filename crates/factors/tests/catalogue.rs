//! Factors and values as plain data: every type comes back with the same bits, and no data panic.

#![allow(
    clippy::unwrap_used,
    reason = "the lint knows tests by their attribute; the generic helpers here have none"
)]

mod common;

use std::sync::Arc;

use common::{Source, key, linearize, residual};
use evergraph_factors::catalogue::{
    Catalogue, CatalogueError, DataError, Description, FactorData, FactorReader, FactorWriter,
    GivenData, NoiseData, Part, STANDARD, StoredFactor, StoredVariable, ValueData,
};
use evergraph_factors::{Conditioned, Depth, FactorError, Linear, LocalJacobian, Prior, RootShift};
use evergraph_model::{
    Arguments, Factor, Graph, Kernel, Linearization, Manifold, Point2, Point3, Pose2, Pose3,
    Robust, Rot2, Rot3, Value, VariableId, VariableType, VectorN,
};
use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;

/// Ids of one graph, whatever their types.
fn ids(count: usize) -> Vec<VariableId> {
    let mut change = Graph::new().change();
    (0..count).map(|_| change.add_variable(&Point2::new(0.0, 0.0)).id()).collect()
}

fn sample(source: &mut Source, kind: &str) -> Value {
    use common::Sample;
    match kind {
        "Rot2" => Value::new(&Rot2::sample(source)),
        "Rot3" => Value::new(&Rot3::sample(source)),
        "Pose2" => Value::new(&Pose2::sample(source)),
        "Pose3" => Value::new(&Pose3::sample(source)),
        "Point2" => Value::new(&Point2::sample(source)),
        "Point3" => Value::new(&Point3::sample(source)),
        "VectorN" => Value::new(&VectorN::new([source.uniform(-9.0, 9.0), 0.1, 1e-300])),
        other => panic!("no sample of {other}"),
    }
}

fn numbers(source: &mut Source, part: Part) -> Vec<f64> {
    let mut value = |kind| sample(source, kind).storage().to_vec();
    match part {
        Part::Number => vec![source.uniform(0.0, 3.0)],
        Part::Direction => source.direction().as_slice().to_vec(),
        Part::Pose2 => value("Pose2"),
        Part::Pose3 => value("Pose3"),
        Part::Point2 => value("Point2"),
        Part::Point3 => value("Point3"),
        Part::Rot2 => value("Rot2"),
        Part::Rot3 => value("Rot3"),
        Part::Vector => value("VectorN"),
        Part::Combinations3 => (0..6).map(|_| source.uniform(-1.0, 1.0)).collect(),
        Part::Combinations6 => (0..12).map(|_| source.uniform(-1.0, 1.0)).collect(),
        _ => panic!("no numbers for {part:?}"),
    }
}

/// Random data of a factor type, and values for its variables.
fn data(source: &mut Source, of: &Description) -> (FactorData, Vec<Value>) {
    if of.name == "Linear" {
        return linear(source);
    }
    let kinds = of.ends;
    let noise = match of.parts {
        [_, Part::Combinations3 | Part::Combinations6] => source.noise(2),
        parts => source.noise(of.rows.unwrap_or(if parts == [Part::Vector] { 3 } else { 1 })),
    };
    let kernel = [None, Kernel::huber(1.3).ok(), Kernel::pseudo_huber(0.4).ok()];
    let data = FactorData {
        name: of.name.into(),
        ends: ids(kinds.len()),
        numbers: of.parts.iter().flat_map(|part| numbers(source, *part)).collect(),
        values: Vec::new(),
        noise: Some((&noise).into()),
        kernel: kernel[source.below(3)],
        given: Vec::new(),
    };
    (data, kinds.iter().map(|kind| sample(source, kind)).collect())
}

fn linear(source: &mut Source) -> (FactorData, Vec<Value>) {
    let kinds: &[&str] = match source.below(3) {
        0 => &["Pose3", "Point3", "Pose3"],
        1 => &["Pose2", "VectorN"],
        _ => &["Pose2", "Pose2", "Point2"],
    };
    let ends = ids(kinds.len());
    let points: Vec<Value> = kinds.iter().map(|kind| sample(source, kind)).collect();
    let width: usize = points.iter().map(Value::dim).sum();
    let g = DMatrix::from_fn(4, width, |_, _| source.uniform(-3.0, 3.0));
    let offset = DVector::from_fn(width, |_, _| source.uniform(-0.1, 0.1));
    let variables: Vec<_> = ends.into_iter().zip(points).collect();
    let shift = [RootShift::None, RootShift::Root, RootShift::InverseRoot][source.below(3)];
    let factor = Linear::new(&variables, shift, g, offset).unwrap();
    let at = kinds.iter().map(|kind| sample(source, kind)).collect();
    (Catalogue::standard().to_data(&factor).unwrap(), at)
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|x| x.to_bits()).collect()
}

/// The same residual, Jacobian and loss, bit for bit.
fn assert_same(a: &dyn Factor, b: &dyn Factor, at: &[Value]) {
    assert_eq!(a.name(), b.name());
    assert_same_numbers(a, b, at);
}

fn assert_same_numbers(a: &dyn Factor, b: &dyn Factor, at: &[Value]) {
    assert_eq!((a.keys(), a.residual_dim()), (b.keys(), b.residual_dim()));
    let (r, s) = (residual(a, at), residual(b, at));
    assert_eq!(bits(&r), bits(&s), "{}", a.name());
    assert_eq!(a.error(&r).to_bits(), b.error(&s).to_bits(), "{}", a.name());
    let ((j, r), (k, s)) = (linearize(a, at), linearize(b, at));
    assert_eq!(bits(j.as_slice()), bits(k.as_slice()), "{}", a.name());
    assert_eq!(bits(r.as_slice()), bits(s.as_slice()), "{}", a.name());
}

fn through_json<T: serde::Serialize + serde::de::DeserializeOwned>(data: &T) -> T {
    serde_json::from_str(&serde_json::to_string(data).unwrap()).unwrap()
}

fn through_bytes<T: serde::Serialize + serde::de::DeserializeOwned>(data: &T) -> T {
    let config = bincode::config::standard();
    let bytes = bincode::serde::encode_to_vec(data, config).unwrap();
    let (read, length) = bincode::serde::decode_from_slice(&bytes, config).unwrap();
    assert_eq!(length, bytes.len());
    read
}

#[test]
fn every_factor_comes_back_with_the_same_bits() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(71);
    for of in STANDARD {
        for _ in 0..50 {
            let (data, at) = data(&mut source, of);
            let factor = catalogue.to_factor(&data).unwrap();
            let stored = catalogue.to_data(&*factor).unwrap();
            for read in [stored.clone(), through_json(&stored), through_bytes(&stored)] {
                assert_eq!(read, stored, "{}", of.name);
                assert_same(&*factor, &*catalogue.to_factor(&read).unwrap(), &at);
            }
        }
    }
}

/// One vocabulary: stable names are those of messages, and the table says what types they take.
#[test]
fn the_table_describes_the_factors() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(72);
    let mut names: Vec<&str> = STANDARD.iter().map(|of| of.name).collect();
    for of in STANDARD {
        let (mut data, at) = data(&mut source, of);
        data.kernel = None;
        let factor = catalogue.to_factor(&data).unwrap();
        assert_eq!(factor.name(), of.name);
        assert!(of.rows.is_none_or(|rows| rows == factor.residual_dim()), "{}", of.name);
        for (position, value) in at.iter().enumerate() {
            assert!(factor.accepts(position, value.kind(), value.dim()), "{}", of.name);
        }
        let lengths: Option<usize> = of.parts.iter().map(|part| part.count()).sum();
        assert!(lengths.is_none_or(|length| length == data.numbers.len()), "{}", of.name);
        assert_eq!(Description::named(of.name), Some(of));
        if !of.ends.is_empty() {
            assert_eq!(Description::of(of.quantity, of.ends), Some(of));
        }
    }
    names.sort_unstable();
    assert_eq!(catalogue.factor_names().collect::<Vec<_>>(), names);
    // What the crate page lists is in the catalogue.
    let page = include_str!("../src/lib.rs");
    let table = page.lines().filter(|line| line.starts_with("//! | [`"));
    let listed = table.filter_map(|line| line.split('|').nth(1));
    let listed: Vec<&str> = listed.flat_map(|cell| cell.split('`').skip(1).step_by(2)).collect();
    assert!(listed.len() > 20, "{listed:?}");
    for name in listed.into_iter().filter(|name| *name != "AutoDiff") {
        let found = names.iter().any(|stored| stored.split('<').next() == Some(name));
        assert!(found, "{name} is not in the catalogue; add it to catalogue/standard.rs");
    }
}

#[test]
fn values_come_back_with_the_same_bits() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(73);
    let kinds: Vec<&str> = catalogue.variable_names().collect();
    assert_eq!(kinds, ["Point2", "Point3", "Pose2", "Pose3", "Rot2", "Rot3", "VectorN"]);
    for kind in kinds {
        for _ in 0..100 {
            let value = sample(&mut source, kind);
            let data = catalogue.to_value_data(&value).unwrap();
            for read in [through_json(&data), through_bytes(&data)] {
                let read = catalogue.to_value(&read).unwrap();
                assert_eq!(read, value);
                assert_eq!(bits(read.storage()), bits(value.storage()));
            }
        }
    }
}

#[test]
fn data_read_as_they_are_documented() {
    let data = FactorData {
        name: "Between<Pose2>".into(),
        ends: vec![],
        numbers: vec![1.0, 0.0, 1.0, 0.0],
        values: vec![],
        noise: Some(NoiseData::Diagonal(vec![20.0, 20.0, 50.0])),
        kernel: Kernel::huber(1.5).ok(),
        given: Vec::new(),
    };
    assert_eq!(
        serde_json::to_string(&data).unwrap(),
        r#"{"name":"Between<Pose2>","ends":[],"numbers":[1.0,0.0,1.0,0.0],"values":[],"#.to_owned()
            + r#""noise":{"diagonal":[20.0,20.0,50.0]},"kernel":{"Huber":{"threshold":1.5}},"given":[]}"#
    );
    // Data without given values may leave them out.
    let text = serde_json::to_string(&data).unwrap().replace(r#","given":[]"#, "");
    assert_eq!(serde_json::from_str::<FactorData>(&text).unwrap(), data);
}

/// Each factor of several variables, with one of them given, then all but one.
#[test]
fn conditioned_factors_come_back_with_the_same_bits() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(74);
    for of in STANDARD {
        let (data, at) = data(&mut source, of);
        let whole = catalogue.to_factor(&data).unwrap();
        let mut factor: Arc<dyn Factor> = whole;
        let mut at: Vec<Value> = at;
        while factor.keys().len() > 1 {
            let place = source.below(factor.keys().len());
            let given = [(factor.keys()[place], at.remove(place))];
            let conditioned = Conditioned::new(factor, &given).unwrap();
            let stored = catalogue.to_data(&conditioned).unwrap();
            assert_eq!((&*stored.name, &*stored.ends), (of.name, conditioned.keys()));
            assert_eq!(stored.ends.len() + stored.given.len(), data.ends.len());
            for read in [stored.clone(), through_json(&stored), through_bytes(&stored)] {
                assert_eq!(read, stored, "{}", of.name);
                let read = catalogue.to_factor(&read).unwrap();
                assert_same_numbers(&conditioned, &*read, &at);
                assert_eq!(catalogue.to_data(&*read).unwrap(), stored, "{}", of.name);
            }
            factor = Arc::new(conditioned);
        }
    }
}

/// Under a kernel as well, but not under one of its own and one of the whole factor.
#[test]
fn conditioned_factors_keep_a_kernel() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(75);
    let of = Description::named("Between<Pose2>").unwrap();
    let (mut data, at) = data(&mut source, of);
    data.kernel = Kernel::huber(0.1).ok();
    let robust = catalogue.to_factor(&data).unwrap();
    data.kernel = None;
    let plain = catalogue.to_factor(&data).unwrap();
    let given = [(data.ends[0], at[0].clone())];
    let kernel = Kernel::huber(0.1).unwrap();
    let inside = Conditioned::new(robust, &given).unwrap();
    let around = Robust::new(Conditioned::new(plain, &given).unwrap(), kernel);
    for factor in [&inside as &dyn Factor, &around] {
        let stored = catalogue.to_data(factor).unwrap();
        assert_eq!(stored.kernel, Some(kernel));
        assert_same_numbers(factor, &*catalogue.to_factor(&stored).unwrap(), &at[1..]);
    }
    let both = Robust::new(inside, kernel);
    let error = catalogue.to_data(&both).unwrap_err();
    let CatalogueError::InvalidFactor { source: DataError::Kernels, .. } = error else {
        panic!("{error}")
    };
}

#[test]
fn given_values_that_do_not_fit_are_typed_errors() {
    let catalogue = Catalogue::standard();
    let mut source = Source::new(76);
    let (data, at) = data(&mut source, Description::named("Between<Pose2>").unwrap());
    let factor = catalogue.to_factor(&data).unwrap();
    let conditioned = Conditioned::new(factor, &[(data.ends[0], at[0].clone())]).unwrap();
    let good = catalogue.to_data(&conditioned).unwrap();
    let error = |change: &dyn Fn(&mut FactorData)| {
        let mut data = good.clone();
        change(&mut data);
        match catalogue.to_factor(&data).unwrap_err() {
            CatalogueError::InvalidFactor { source, .. } => source,
            other => panic!("{other}"),
        }
    };
    type E = DataError;
    assert!(matches!(error(&|d| d.given[0].position = 2), E::Given { given: 1, ends: 1 }));
    assert!(matches!(error(&|d| d.given[0].position = u32::MAX), E::Given { .. }));
    assert!(matches!(error(&|d| d.given.push(d.given[0].clone())), E::Given { given: 2, .. }));
    assert!(matches!(error(&|d| d.ends.clear()), E::Ends { expected: 2, actual: 1 }));
    let all = |d: &mut FactorData| {
        d.ends.clear();
        d.given.push(GivenData { position: 1, ..d.given[0].clone() });
    };
    assert!(matches!(error(&all), E::Given { given: 2, ends: 0 }));
    let of_kind = |kind: &str, numbers: &[f64]| {
        let value = ValueData { kind: kind.into(), numbers: numbers.to_vec() };
        error(&move |d| d.given[0].value = value.clone())
    };
    assert!(matches!(of_kind("Point2", &[1.0, 2.0]), E::Given { .. }));
    assert!(matches!(of_kind("Pose2", &[1.0, 2.0, 3.0, 4.0]), E::Value(_)));
    assert!(matches!(of_kind("acme.Bias", &[]), E::Value(_)));
}

/// A type with a fault in the code that stores and loads it.
#[derive(Clone, Debug, PartialEq)]
struct Careless(f64);

impl Manifold for Careless {
    const NAME: &'static str = "acme.Careless";
    const COMPONENTS: &'static [&'static str] = &["x"];
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
        assert!(storage[0] < 7.0, "no such value");
        Self(storage[0])
    }
    fn retract(&self, d: &[f64]) -> Self {
        Self(self.0 + d[0])
    }
    fn local(&self, to: &Self, out: &mut [f64]) {
        out[0] = to.0 - self.0;
    }
}

impl StoredVariable for Careless {
    const LENGTH: Option<usize> = Some(1);
}

/// A factor with such a fault.
#[derive(Clone, Debug)]
struct Moody(First);

impl Factor for Moody {
    fn name(&self) -> String {
        "acme.Moody".into()
    }
    fn keys(&self) -> &[VariableId] {
        self.0.keys()
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, position: usize, kind: &VariableType, dim: usize) -> bool {
        self.0.accepts(position, kind, dim)
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        self.0.residual(at, out);
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        self.0.linearize(at, out);
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

impl StoredFactor for Moody {
    fn stored_name() -> std::borrow::Cow<'static, str> {
        "acme.Moody".into()
    }
    fn store(&self, _: &mut FactorWriter<'_>) -> Result<(), DataError> {
        assert!(self.0.at < 1.0, "not today");
        Ok(())
    }
    fn restore(_: &mut FactorReader<'_>) -> Result<Self, DataError> {
        panic!("nor tomorrow");
    }
}

#[test]
fn panics_in_users_code_are_typed_errors() {
    let mut catalogue = Catalogue::standard();
    catalogue.register_variable::<Careless>().unwrap();
    catalogue.register_factor::<Moody>().unwrap();
    let value = ValueData { kind: "acme.Careless".into(), numbers: vec![6.0] };
    assert_eq!(catalogue.to_value(&value).unwrap(), Value::new(&Careless(6.0)));
    let error = catalogue.to_value(&ValueData { numbers: vec![8.0], ..value }).unwrap_err();
    assert!(
        matches!(&error, CatalogueError::InvalidValue { name, source: DataError::Panicked { message } }
            if name == "acme.Careless" && message == "no such value"),
        "{error}"
    );

    let moody = |mood| Moody(First { keys: [ids(1)[0]], at: mood });
    let panicked = |error: CatalogueError, expected: &str| match &error {
        CatalogueError::InvalidFactor { source: DataError::Panicked { message }, name } => {
            assert_eq!((&**name, &**message), ("acme.Moody", expected));
        }
        _ => panic!("{error}"),
    };
    panicked(catalogue.to_data(&moody(1.0)).unwrap_err(), "not today");
    let data = catalogue.to_data(&moody(0.0)).unwrap();
    panicked(catalogue.to_factor(&data).unwrap_err(), "nor tomorrow");
}

/// A factor of a user: the distance of a vector's first entry from a number.
#[derive(Clone, Debug)]
struct First {
    keys: [VariableId; 1],
    at: f64,
}

impl Factor for First {
    fn name(&self) -> String {
        "acme.First".into()
    }
    fn keys(&self) -> &[VariableId] {
        &self.keys
    }
    fn residual_dim(&self) -> usize {
        1
    }
    fn accepts(&self, position: usize, kind: &VariableType, _: usize) -> bool {
        position == 0 && kind.is::<VectorN>()
    }
    fn residual(&self, at: &Arguments<'_>, out: &mut [f64]) {
        out[0] = at.storage(0)[0] - self.at;
    }
    fn linearize(&self, at: &Arguments<'_>, out: &mut Linearization<'_>) {
        out.block_mut(0)[0] = 1.0;
        self.residual(at, out.residual_mut());
    }
    fn as_any(&self) -> &dyn std::any::Any {
        self
    }
}

impl StoredFactor for First {
    fn stored_name() -> std::borrow::Cow<'static, str> {
        "acme.First".into()
    }
    fn store(&self, to: &mut FactorWriter<'_>) -> Result<(), DataError> {
        to.number(self.at);
        Ok(())
    }
    fn restore(from: &mut FactorReader<'_>) -> Result<Self, DataError> {
        let at = from.number()?;
        if at < 0.0 {
            return Err(DataError::other("it lies behind the wall"));
        }
        Ok(Self { keys: [from.key::<VectorN>(0)?.id()], at })
    }
}

/// Another type under a name that is taken.
#[derive(Clone, Debug, PartialEq)]
struct Impostor;

impl Manifold for Impostor {
    const NAME: &'static str = "Pose2";
    const COMPONENTS: &'static [&'static str] = &[];
    fn dim(&self) -> usize {
        0
    }
    fn storage_len(&self) -> usize {
        0
    }
    fn store(&self, _: &mut [f64]) {}
    fn load(_: &[f64]) -> Self {
        Self
    }
    fn retract(&self, _: &[f64]) -> Self {
        Self
    }
    fn local(&self, _: &Self, _: &mut [f64]) {}
}

impl LocalJacobian for Impostor {
    fn local_jacobian(&self, _: &[f64], _: &mut [f64]) {}
}

impl StoredVariable for Impostor {
    const LENGTH: Option<usize> = Some(0);
}

#[test]
fn users_register_their_own_types() {
    let standard = Catalogue::standard();
    let mut catalogue = standard.clone();
    catalogue.register_factor::<First>().unwrap();
    catalogue.register_factor::<First>().unwrap();
    let factor = First { keys: [ids(1)[0]], at: 0.25 };
    let at = [Value::new(&VectorN::new([0.1, 0.2]))];
    for kernel in [None, Kernel::huber(0.01).ok()] {
        let factor: Box<dyn Factor> = match kernel {
            None => Box::new(factor.clone()),
            Some(kernel) => Box::new(Robust::new(factor.clone(), kernel)),
        };
        let data = through_bytes(&catalogue.to_data(&*factor).unwrap());
        assert_same(&*factor, &*catalogue.to_factor(&data).unwrap(), &at);

        let unknown = standard.to_factor(&data).unwrap_err();
        assert!(matches!(&unknown, CatalogueError::UnknownFactor { name, known }
            if name == "acme.First" && known.len() == STANDARD.len()));
        let message = unknown.to_string();
        assert!(message.contains("acme.First") && message.contains("Range<Pose3, Point3>"));
        let unknown = standard.to_data(&*factor).unwrap_err();
        assert!(
            matches!(unknown, CatalogueError::UnknownFactor { name, .. } if name.contains("acme.First"))
        );
    }
    let mut data = catalogue.to_data(&factor).unwrap();
    data.numbers[0] = -1.0;
    let error = catalogue.to_factor(&data).unwrap_err().to_string();
    assert_eq!(error, "the data of acme.First are not valid: it lies behind the wall");
}

#[test]
fn two_types_under_one_name_are_refused() {
    let mut catalogue = Catalogue::standard();
    let error = catalogue.register_variable::<Impostor>().unwrap_err();
    assert!(matches!(error, CatalogueError::NameTaken { name } if name == "Pose2"));
    // What is registered stays, and a value of the other type is not taken for it.
    let value = Value::new(&Pose2::new(1.0, 2.0, 3.0));
    assert_eq!(catalogue.to_value(&catalogue.to_value_data(&value).unwrap()).unwrap(), value);
    let error = catalogue.to_value_data(&Value::new(&Impostor)).unwrap_err();
    assert!(matches!(error, CatalogueError::UnknownVariable { name, .. } if name == "Pose2"));

    // A factor of another type under the name of one of ours.
    let mut other = Catalogue::empty();
    other.register_factor::<Prior<Impostor>>().unwrap();
    assert_eq!(other.factor_names().collect::<Vec<_>>(), ["Prior<Pose2>"]);
    let error = other.register_factor::<Prior<Pose2>>().unwrap_err();
    assert!(matches!(error, CatalogueError::NameTaken { name } if name == "Prior<Pose2>"));
}

#[test]
fn damaged_data_are_typed_errors() {
    let catalogue = Catalogue::standard();
    let depth = Depth::new(key(&common::level(0.0, 0.0, 0.0, 0.0)), 2.0, common::unit(1)).unwrap();
    let good = catalogue.to_data(&depth).unwrap();
    let error = |change: &dyn Fn(&mut FactorData)| {
        let mut data = good.clone();
        change(&mut data);
        match catalogue.to_factor(&data).unwrap_err() {
            CatalogueError::InvalidFactor { name, source } if name == data.name => source,
            other => panic!("{other}"),
        }
    };
    type E = DataError;
    assert!(matches!(error(&|d| d.ends.clear()), E::Ends { expected: 1, actual: 0 }));
    assert!(matches!(error(&|d| d.ends = ids(2)), E::Ends { expected: 1, actual: 2 }));
    assert!(matches!(error(&|d| d.numbers.clear()), E::Numbers { expected: 1, actual: 0 }));
    assert!(matches!(error(&|d| d.numbers.push(1.0)), E::Numbers { expected: 1, actual: 2 }));
    assert!(matches!(error(&|d| d.numbers[0] = f64::NAN), E::NotFinite { index: 0, .. }));
    assert!(matches!(error(&|d| d.noise = None), E::NoiseMissing));
    let noise = |noise: NoiseData| error(&move |d| d.noise = Some(noise.clone()));
    assert!(matches!(noise(NoiseData::Upper(vec![1.0; 2])), E::NoiseEntries { actual: 2 }));
    assert!(matches!(noise(NoiseData::Diagonal(vec![1.0; 65])), E::NoiseEntries { actual: 65 }));
    assert!(matches!(noise(NoiseData::Diagonal(vec![])), E::Noise(_)));
    assert!(matches!(noise(NoiseData::Diagonal(vec![-1.0])), E::Noise(_)));
    assert!(matches!(noise(NoiseData::Upper(vec![f64::INFINITY])), E::Noise(_)));
    assert!(matches!(
        noise(NoiseData::Upper(vec![1.0; 3])),
        E::Factor(FactorError::NoiseDimension { expected: 1, actual: 2, .. })
    ));
    let value = ValueData { kind: "Pose2".into(), numbers: vec![0.0; 4] };
    assert!(matches!(
        error(&|d| d.values.push(value.clone())),
        E::Values { expected: 0, actual: 1 }
    ));
    let kernel: Kernel = serde_json::from_str(r#"{"Huber":{"threshold":-1.0}}"#).unwrap();
    assert!(matches!(error(&|d| d.kernel = Some(kernel)), E::Kernel(_)));
    assert!(matches!(
        error(&|d| {
            d.name = "Range<Pose2, Pose2>".into();
            d.ends = ids(2);
            d.numbers = vec![-1.0];
        }),
        E::Factor(FactorError::NegativeRange { .. })
    ));
    assert!(matches!(
        error(&|d| {
            d.name = "Linear".into();
            d.values = vec![value.clone()];
        }),
        E::Value(_)
    ));
    let error = catalogue.to_value(&value).unwrap_err().to_string();
    assert!(error.contains("cosine and sine") && error.contains("Pose2"), "{error}");
}

/// A number that damage may leave.
fn bad_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(0.0),
        Just(-0.0),
        Just(1e308),
        Just(5e-324),
        -2.0..2.0_f64,
    ]
}

fn damage(data: &mut FactorData, kind: u8, place: usize, number: f64) {
    let put = |numbers: &mut Vec<f64>| {
        let at = place % (numbers.len() + 1);
        match kind % 3 {
            0 if at < numbers.len() => numbers[at] = number,
            1 if at < numbers.len() => {
                numbers.remove(at);
            }
            _ => numbers.insert(at, number),
        }
    };
    match kind / 3 % 8 {
        0 | 1 => put(&mut data.numbers),
        2 => match &mut data.noise {
            Some(NoiseData::Diagonal(entries) | NoiseData::Upper(entries)) => put(entries),
            None => data.noise = Some(NoiseData::Diagonal(vec![number])),
        },
        3 => match data.values.first_mut() {
            Some(value) => put(&mut value.numbers),
            None => data.values.push(ValueData { kind: "Rot3".into(), numbers: vec![number] }),
        },
        4 => data.name = STANDARD[place % STANDARD.len()].name.into(),
        5 => data.ends = ids(place % 4),
        6 => data.given.push(GivenData {
            position: (place % 4) as u32,
            variable: ids(1)[0],
            value: ValueData {
                kind: ["Pose2", "Pose3", "Point2", "Point3"][place / 4 % 4].into(),
                numbers: [number, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0][..[4, 7, 2, 3][place / 4 % 4]]
                    .into(),
            },
        }),
        _ => match data.noise.take() {
            Some(NoiseData::Diagonal(entries)) => data.noise = Some(NoiseData::Upper(entries)),
            Some(NoiseData::Upper(entries)) => data.noise = Some(NoiseData::Diagonal(entries)),
            None => data.values.clear(),
        },
    }
}

/// Accepted data are those of a factor that comes back the same.
fn check(catalogue: &Catalogue, data: &FactorData) {
    let Ok(factor) = catalogue.to_factor(data) else { return };
    let stored = catalogue.to_data(&*factor).unwrap();
    let again = catalogue.to_factor(&stored).unwrap();
    let again = catalogue.to_data(&*again).unwrap();
    let all = |data: &FactorData| {
        let noise = data.noise.as_ref().map(|noise| match noise {
            NoiseData::Diagonal(entries) | NoiseData::Upper(entries) => bits(entries),
        });
        let values: Vec<_> = data.values.iter().map(|value| bits(&value.numbers)).collect();
        (bits(&data.numbers), values, noise)
    };
    assert_eq!(all(&again), all(&stored));
    assert_eq!((&again.name, &again.ends), (&stored.name, &stored.ends));
    if !STANDARD.iter().any(|of| of.name == data.name && of.parts.contains(&Part::Direction)) {
        assert_eq!(bits(&stored.numbers), bits(&data.numbers), "{}", data.name);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]

    #[test]
    fn damaged_data_never_panic(
        seed in any::<u64>(),
        of in 0..STANDARD.len(),
        hits in prop::collection::vec((any::<u8>(), any::<usize>(), bad_number()), 1..4),
    ) {
        let catalogue = Catalogue::standard();
        let (mut data, _) = data(&mut Source::new(seed), &STANDARD[of]);
        for (kind, place, number) in hits {
            damage(&mut data, kind, place, number);
        }
        check(&catalogue, &data);
    }

    #[test]
    fn random_bytes_never_panic(
        seed in any::<u64>(),
        of in 0..STANDARD.len(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let catalogue = Catalogue::standard();
        let (data, _) = data(&mut Source::new(seed), &STANDARD[of]);
        let config = bincode::config::standard().with_limit::<1_000_000>();
        let mut bytes = bincode::serde::encode_to_vec(&data, config).unwrap();
        for (place, byte) in flips {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        if let Ok((data, _)) =
            bincode::serde::decode_from_slice::<FactorData, _>(&bytes, config)
        {
            check(&catalogue, &data);
        }
    }
}
