//! Which nodes go.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use clap::Args;
use evergraph::Replayer;
use evergraph::formats::{parse_id, spell_id};
use evergraph::model::VariableId;

use crate::error::Error;

/// Which nodes go. Those that hold the gauge are never among them.
#[derive(Args, Clone, Debug)]
#[group(required = true, multiple = false)]
pub(crate) struct Choice {
    /// This share of all variables, landmarks included, but the pose that holds the gauge; --order says
    /// which
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true, value_parser = share)]
    pub fraction: Option<f64>,
    /// All poses but each K-th in the order of the file, the first included; landmarks stay
    #[arg(long, value_name = "K")]
    pub keep_every: Option<NonZeroUsize>,
    /// The nodes of this file, one in a line: ids, or names as PyFactorGraph and messages have them
    /// (A12, L0); blank lines and `#` lines are passed over
    #[arg(long, value_name = "LIST-FILE")]
    pub nodes: Option<PathBuf>,
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x > 0.0 && x <= 1.0 => Ok(x),
        _ => Err("give a number above 0, at most 1".into()),
    }
}

/// Who can go.
pub(crate) struct Candidates {
    /// In the order in which the choice names them: of the file, or of the list.
    pub nodes: Vec<VariableId>,
    /// How many of them go.
    pub count: usize,
}

impl Choice {
    /// Who can go, and how many of them.
    pub(crate) fn candidates(&self, replayer: &Replayer) -> Result<Candidates, Error> {
        let replay = replayer.replay();
        let fixed: HashSet<VariableId> = replay.fixed().map(|(_, variable)| variable).collect();
        let is_gauge = |variable| {
            let mut priors = replay.gauge_priors().iter();
            fixed.contains(&variable) || priors.any(|prior| prior.variable == variable)
        };
        if let Some(path) = &self.nodes {
            let nodes = read_list(path, replayer, is_gauge)?;
            return Ok(Candidates { count: nodes.len(), nodes });
        }
        let all: Vec<(u64, VariableId)> = replay.ids().collect();
        let (nodes, count): (Vec<VariableId>, _) = if let Some(every) = self.keep_every {
            let poses = all.iter().filter(|(id, variable)| replay.pose(*id) == Some(*variable));
            let gone = poses.enumerate().filter(|(place, _)| *place % every != 0);
            let nodes: Vec<VariableId> =
                gone.map(|(_, (_, variable))| *variable).filter(|it| !is_gauge(*it)).collect();
            let count = nodes.len();
            (nodes, count)
        } else {
            let nodes: Vec<VariableId> =
                all.iter().map(|(_, variable)| *variable).filter(|it| !is_gauge(*it)).collect();
            let count = (self.fraction.unwrap_or(0.0) * nodes.len() as f64).round() as usize;
            (nodes, count)
        };
        if count == 0 {
            let file = replayer.name().into();
            return Err(Error::NothingToRemove { file, variables: all.len() });
        }
        Ok(Candidates { nodes, count })
    }
}

/// The variables that a file lists.
fn read_list(
    path: &Path,
    replayer: &Replayer,
    is_gauge: impl Fn(VariableId) -> bool,
) -> Result<Vec<VariableId>, Error> {
    let unreadable = |source| Error::Read { path: path.into(), source };
    let bytes = fs::read(path).map_err(unreadable)?;
    let mut lines: HashMap<VariableId, usize> = HashMap::new();
    let mut nodes = Vec::new();
    for (at, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
        let at = at + 1;
        let refused = |problem| Error::List { path: path.into(), line: at, problem };
        let line = std::str::from_utf8(line).map_err(|_| refused("the line is not text".into()))?;
        let word = line.trim();
        if word.is_empty() || word.starts_with('#') {
            continue;
        }
        let id = parse_id(word).ok_or_else(|| {
            let shown: String = word.chars().take(40).collect();
            refused(format!(
                "`{shown}` is not an id; a line holds one whole number from 0 on, or one name such \
                 as A12"
            ))
        })?;
        let (name, file) = (spell_id(id), replayer.name());
        let variable = replayer.replay().variable(id).ok_or_else(|| {
            refused(format!("{name} is no variable of {file} that is in the map"))
        })?;
        if is_gauge(variable) {
            return Err(refused(format!(
                "{name} is fixed or holds the gauge of {file} and cannot be removed; leave it out of \
                 the list, or FIX another pose there"
            )));
        }
        if let Some(first) = lines.insert(variable, at) {
            return Err(refused(format!("{name} was given before, in line {first}")));
        }
        nodes.push(variable);
    }
    if nodes.is_empty() {
        let problem = "no id is in the file; name at least one to remove".into();
        return Err(Error::List { path: path.into(), line: 1, problem });
    }
    Ok(nodes)
}
