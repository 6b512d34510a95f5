//! A graph as plain data, with its identity: ids are valid again after loading.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Graph, Layout, Term, Used, Variable};
use crate::error::GraphError;
use crate::factor::Factor;
use crate::ids::{Ids, UsedNumbers};
use crate::key::{FactorId, FactorIndex, VariableId, Version};
use crate::manifold::VariableType;
use crate::slots::Slots;
use crate::value::Value;

/// A graph as plain data. `F` is the form that its factors were given.
///
/// It holds the identity of the graph, every slot with the order in which slots are used again, and
/// the layout of the values: equal changes give equal results before saving and after loading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedGraph<F> {
    lineage: u64,
    used: Vec<SavedIds>,
    variables: Vec<Option<SavedVariable>>,
    free_variables: Vec<u32>,
    factors: Vec<Option<SavedFactor<F>>>,
    free_factors: Vec<u32>,
    value_layout: Layout,
    tangent_layout: Layout,
}

/// The ids of one source that were used, as intervals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct SavedIds {
    origin: u64,
    variables: Vec<(u64, u64)>,
    factors: Vec<(u64, u64)>,
}

/// A variable of a saved graph; its value stands in the array of values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedVariable {
    id: VariableId,
    kind: String,
    value: (u32, u32),
    tangent: (u32, u32),
    factors: Vec<FactorIndex>,
    version: Version,
    fixed: bool,
}

/// A factor of a saved graph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedFactor<F> {
    id: FactorId,
    factor: F,
}

impl Graph {
    /// The graph as plain data; `encode` gives each factor its plain form.
    ///
    /// # Errors
    /// The first error of `encode`.
    pub fn save<F, E>(
        &self,
        mut encode: impl FnMut(&Arc<dyn Factor>) -> Result<F, E>,
    ) -> Result<SavedGraph<F>, E> {
        let variable = |slot: usize| {
            let id = self.variables.id_at(slot)?;
            let Variable { kind, value, tangent, factors, version, fixed } =
                self.variables.at(slot)?;
            Some(SavedVariable {
                id,
                kind: kind.name().to_owned(),
                value: *value,
                tangent: *tangent,
                factors: factors.to_vec(),
                version: *version,
                fixed: *fixed,
            })
        };
        let mut factor = |slot: usize| {
            let entry = self.factors.id_at(slot).zip(self.factors.at(slot));
            let saved =
                entry.map(|(id, term)| Ok(SavedFactor { id, factor: encode(&term.factor)? }));
            saved.transpose()
        };
        let used = self.used.iter().map(|used| SavedIds {
            origin: used.origin,
            variables: used.variables.intervals().collect(),
            factors: used.factors.intervals().collect(),
        });
        Ok(SavedGraph {
            lineage: self.ids.lineage(),
            used: used.collect(),
            variables: (0..self.variables.capacity()).map(variable).collect(),
            free_variables: self.variables.free().to_vec(),
            factors: (0..self.factors.capacity()).map(&mut factor).collect::<Result<_, E>>()?,
            free_factors: self.factors.free().to_vec(),
            value_layout: self.value_layout.clone(),
            tangent_layout: self.tangent_layout.clone(),
        })
    }

    /// A graph from plain data. `values` are the numbers of its variables, laid out by
    /// [`value_range`](Self::value_range); `kind` finds a variable type by name, `decode` makes a
    /// factor from its plain form.
    ///
    /// Ids that were saved are valid in the loaded graph. What it mints from now on differs from
    /// what the saved graph, or another copy of it, mints.
    ///
    /// # Errors
    /// [`GraphError::Damaged`] for data that contradicts itself, [`GraphError::UnknownType`],
    /// [`GraphError::NonFiniteValue`], everything that adding a factor may give, and the errors of
    /// `decode`.
    pub fn load<F, E: From<GraphError>>(
        saved: &SavedGraph<F>,
        values: &[f64],
        mut kind: impl FnMut(&str) -> Option<&'static VariableType>,
        mut decode: impl FnMut(&F) -> Result<Arc<dyn Factor>, E>,
    ) -> Result<Self, E> {
        if values.len() != saved.value_layout.len as usize {
            return Err(damaged("the array of values has another length than its layout").into());
        }
        let ids = Ids::of_lineage(saved.lineage);
        let mut graph = Self {
            used: saved.used()?,
            ids,
            value_layout: saved.value_layout.clone(),
            tangent_layout: saved.tangent_layout.clone(),
            ..Self::new()
        };
        let own = Used::nothing(graph.ids.origin());
        graph.used.push(own);
        graph.variables = load_variables(saved, values, &mut kind)?;
        graph.check_layouts()?;
        for slot in 0..graph.variables.capacity() {
            let Some(&Variable { kind, tangent, fixed, .. }) = graph.variables.at(slot) else {
                continue;
            };
            graph.count(kind, 1);
            if !fixed {
                graph.unknowns += 1;
                graph.dim += tangent.1 as usize;
            }
        }
        let mut terms = Vec::with_capacity(saved.factors.len());
        for entry in &saved.factors {
            terms.push(match entry {
                Some(SavedFactor { id, factor }) => {
                    Some((*id, graph.resolve(*id, &decode(factor)?, &[])?))
                }
                None => None,
            });
        }
        graph.factors = Slots::from_parts(terms, saved.free_factors.clone())
            .ok_or_else(|| damaged("its list of free factor slots does not fit its factors"))?;
        graph.check_adjacency()?;
        graph.check_numbers()?;
        Ok(graph)
    }

    /// Each number of the flat arrays belongs to one variable or to one free range.
    fn check_layouts(&self) -> Result<(), GraphError> {
        let variables = || self.variables.indices().filter_map(|slot| self.variables.at(slot));
        let fits = self.value_layout.is_covered_by(variables().map(|v| v.value))
            && self.tangent_layout.is_covered_by(variables().map(|v| v.tangent));
        if fits { Ok(()) } else { Err(damaged("ranges of variables overlap or leave gaps")) }
    }

    /// Variables list exactly the factors that are on them.
    fn check_adjacency(&self) -> Result<(), GraphError> {
        let on = |term: &Term, slot: usize| term.variables.iter().any(|v| v.index() == slot);
        let mut listed = 0;
        for slot in self.variables.indices() {
            let Some(variable) = self.variables.at(slot) else { continue };
            for factor in &variable.factors {
                if !self.factors.at(factor.index()).is_some_and(|term| on(term, slot)) {
                    return Err(damaged("a variable lists a factor that is not on it"));
                }
            }
            let mut sorted = variable.factors.clone();
            sorted.sort_unstable();
            sorted.dedup();
            listed += sorted.len();
        }
        let terms = self.factors.indices().filter_map(|slot| self.factors.at(slot));
        let ends: usize = terms.map(|term| term.variables.len()).sum();
        let lists: usize = self
            .variables
            .indices()
            .filter_map(|slot| self.variables.at(slot))
            .map(|variable| variable.factors.len())
            .sum();
        if listed == ends && lists == ends {
            Ok(())
        } else {
            Err(damaged("a factor is missing in the list of one of its variables"))
        }
    }

    /// Ids in the graph count as used.
    fn check_numbers(&self) -> Result<(), GraphError> {
        let of = |origin| self.used.iter().find(|used| used.origin == origin);
        let variables = self.variables.indices().filter_map(|slot| self.variables.id_at(slot));
        let factors = self.factors.indices().filter_map(|slot| self.factors.id_at(slot));
        let mut variables = variables
            .map(|id| of(id.origin).is_some_and(|used| used.variables.contains(id.number)));
        let mut factors =
            factors.map(|id| of(id.origin).is_some_and(|used| used.factors.contains(id.number)));
        if variables.all(|used| used) && factors.all(|used| used) {
            Ok(())
        } else {
            Err(damaged("an id is not among the ids that were used"))
        }
    }
}

impl<F> SavedGraph<F> {
    fn used(&self) -> Result<Vec<Used>, GraphError> {
        let numbers = |intervals: &[(u64, u64)]| {
            UsedNumbers::from_intervals(intervals)
                .ok_or_else(|| damaged("its intervals of used ids are not in order"))
        };
        let used = self.used.iter().map(|saved| {
            Ok(Used {
                origin: saved.origin,
                variables: numbers(&saved.variables)?,
                factors: numbers(&saved.factors)?,
            })
        });
        used.collect()
    }
}

fn load_variables<F>(
    saved: &SavedGraph<F>,
    values: &[f64],
    kind: &mut impl FnMut(&str) -> Option<&'static VariableType>,
) -> Result<Slots<VariableId, Variable>, GraphError> {
    let mut entries = Vec::with_capacity(saved.variables.len());
    for entry in &saved.variables {
        let Some(SavedVariable { id, kind: name, value, tangent, factors, version, fixed }) = entry
        else {
            entries.push(None);
            continue;
        };
        let kind = kind(name).ok_or_else(|| GraphError::UnknownType { name: name.clone() })?;
        let end = value.0.checked_add(value.1).ok_or_else(|| damaged("a range is too long"))?;
        let numbers = values
            .get(value.0 as usize..end as usize)
            .ok_or_else(|| damaged("a variable's range leaves the array of values"))?;
        if numbers.iter().any(|x| !x.is_finite()) {
            return Err(GraphError::NonFiniteValue {
                variable: *id,
                value: format!("{numbers:?}"),
            });
        }
        if Value::from_parts(kind, numbers)?.dim() != tangent.1 as usize {
            return Err(damaged("a variable has another tangent dimension than its value"));
        }
        let (factors, value, tangent) = (factors.as_slice().into(), *value, *tangent);
        let (version, fixed) = (*version, *fixed);
        entries.push(Some((*id, Variable { kind, value, tangent, factors, version, fixed })));
    }
    Slots::from_parts(entries, saved.free_variables.clone())
        .ok_or_else(|| damaged("its list of free variable slots does not fit its variables"))
}

fn damaged(problem: &str) -> GraphError {
    GraphError::Damaged { problem: problem.to_owned() }
}
