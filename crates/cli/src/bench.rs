//! `evergraph bench`.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use evergraph::formats::Document;
use evergraph::solver::{BatchReport, BatchSettings, Relinearization, Settings};
use evergraph::{Objective, Phase, Profile, Replayer};
use serde::Serialize;
use serde_json::{Value, json};

use crate::error::Error;
use crate::options::{Common, Policy, Solving, StartFrom};
use crate::reading::Reading;
use crate::report::{self, SCHEMA, Times};
use crate::table::{CONVENTION, Columns, Rows, milliseconds, number};
use crate::warnings::warn_of_landmarks;

const EXAMPLES: &str = "\
Examples:
  evergraph bench manhattan.g2o
  evergraph bench city10000.txt --threads 1 --repeats 5 --report out.json
  evergraph bench sphere2500.g2o --relinearize never --max-steps 1000
  evergraph bench sphere2500.g2o --batch

Each repeat does the work twice: first without a look at the clock inside of an update, for the times
of the steps, then with it, for the profile. Times are medians over the repeats; the profile is that of
the repeat with the median time, so that its parts are the whole. What is outside the phases of a
replay is the newest pose's estimate after each step. While other threads work, the phase that waits
for them goes on: with --threads 1 each phase has its own work.";

/// Measure where the time of a replay or an optimization goes
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Arguments {
    /// A g2o, TORO, iSAM or PyFactorGraph file
    file: PathBuf,
    /// Measure this many times
    #[arg(long, value_name = "N", default_value = "3")]
    repeats: NonZeroUsize,
    /// Stop after N steps
    #[arg(long, value_name = "N", conflicts_with = "batch")]
    max_steps: Option<usize>,
    #[command(flatten)]
    policy: Policy,
    #[command(flatten)]
    solving: Solving,
    /// Solve the whole file at once, as `optimize` does, instead of step by step
    #[arg(long, help_heading = "Solving", conflicts_with = "Policy")]
    batch: bool,
    /// Where new variables start [default: odometry; with --batch: file]
    #[arg(long, value_enum, help_heading = "Solving")]
    initial: Option<StartFrom>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    pub(crate) common: Common,
}

impl Arguments {
    fn start(&self) -> StartFrom {
        let usual = if self.batch { StartFrom::File } else { StartFrom::Odometry };
        self.initial.unwrap_or(usual)
    }

    fn settings(&self) -> Result<Settings, Error> {
        let relinearization = match self.batch {
            true => Relinearization::NEVER,
            false => self.policy.relinearization("bench")?,
        };
        Ok(self.solving.settings(relinearization, self.common.threads()))
    }

    /// What the mean of a phase is over.
    fn unit(&self) -> &'static str {
        if self.batch { "iteration" } else { "step" }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<(), Error> {
    let common = &arguments.common;
    let output = common.output();
    let settings = arguments.settings()?;
    let begun = Instant::now();
    let document = arguments.reading.read(&arguments.file, common)?;
    let reading = begun.elapsed();
    if let Some(path) = &common.report {
        crate::files::check_writable(path)?;
    }

    let measure = |is_profiled| {
        let run = Run::measure(arguments, &document, settings, is_profiled);
        run.map_err(|error| error.with_gauge(arguments.solving.prior.0, &document))
    };
    let mut plain = Vec::new();
    let mut profiled = Vec::new();
    for _ in 0..arguments.repeats.get() {
        plain.push(measure(false)?);
        profiled.push(measure(true)?);
    }
    let measured = Measured { arguments, reading, settings, plain, profiled };
    report::save(common.report.as_deref(), &measured.report()?)?;
    warn_of_landmarks(&measured.last().replayer, output);
    output.result(&measured.table())?;
    output.result(&measured.profile_table())
}

/// A replay or an optimization that was measured.
#[derive(Debug)]
struct Run {
    /// Of each step; of a batch the whole.
    updates: Vec<Duration>,
    times: Times,
    profile: Profile,
    cliques_eliminated: usize,
    relinearizations: usize,
    batch: Option<BatchReport>,
    /// At the end.
    objective: Objective,
    replayer: Replayer,
}

impl Run {
    fn measure(
        arguments: &Arguments,
        document: &Document,
        settings: Settings,
        is_profiled: bool,
    ) -> Result<Self, Error> {
        let options = arguments.solving.replay_options(arguments.start());
        let mut replayer = Replayer::new(document, &options, settings)?;
        replayer.smoother_mut().set_profiling(is_profiled);
        let begun = Instant::now();
        let mut run = Self {
            updates: Vec::with_capacity(replayer.replay().len()),
            times: Times::default(),
            profile: Profile::default(),
            cliques_eliminated: 0,
            relinearizations: 0,
            batch: None,
            objective: Objective::default(),
            replayer,
        };
        if arguments.batch {
            run.optimize()?;
        } else {
            run.replay(arguments.max_steps.unwrap_or(usize::MAX))?;
        }
        run.times = Times::of(&run.updates, begun.elapsed());
        run.profile = *run.replayer.smoother().profile();
        let objective = run.replayer.objective();
        run.objective = objective.map_err(|source| Error::unsolvable(&run.replayer, source))?;
        Ok(run)
    }

    fn replay(&mut self, steps: usize) -> Result<(), Error> {
        while self.updates.len() < steps {
            let Some(done) = self.replayer.step()? else { break };
            self.updates.push(done.update);
            self.cliques_eliminated += done.report.cliques_eliminated;
            self.relinearizations += done.report.variables_relinearized;
        }
        Ok(())
    }

    /// Everything in one change, and a batch to convergence.
    fn optimize(&mut self) -> Result<(), Error> {
        let done = self.replayer.everything()?;
        let start = Instant::now();
        let batch = self.replayer.smoother_mut().optimize(&BatchSettings::default());
        self.updates.push(done.update + start.elapsed());
        let batch = batch.map_err(|source| Error::unsolvable(&self.replayer, source))?;
        let cliques = self.replayer.smoother().size().cliques;
        self.cliques_eliminated =
            done.report.cliques_eliminated + batch.iterations as usize * cliques;
        self.relinearizations = batch.iterations as usize * self.replayer.graph().variable_count();
        self.batch = Some(batch);
        Ok(())
    }

    fn update(&self) -> Duration {
        self.updates.iter().sum()
    }

    /// Steps, or iterations of a batch.
    fn units(&self) -> usize {
        self.batch.map_or(self.updates.len(), |batch| batch.iterations as usize)
    }
}

/// Part of the time of the updates.
#[derive(Clone, Copy, Debug, Serialize)]
struct Part {
    phase: &'static str,
    ms: f64,
    /// Of the time of all updates.
    share: f64,
    /// A step; of a batch, an iteration.
    mean_us: f64,
}

/// All repeats.
struct Measured<'a> {
    arguments: &'a Arguments,
    reading: Duration,
    settings: Settings,
    plain: Vec<Run>,
    profiled: Vec<Run>,
}

impl Measured<'_> {
    /// One of the runs; those without a profile all end in the same bits.
    fn last(&self) -> &Run {
        self.plain.last().expect("there is at least one repeat")
    }

    fn times(&self) -> Times {
        Times::median(self.plain.iter().map(|run| run.times))
    }

    /// The repeat with the median time: medians of each phase would not add up.
    fn profile(&self) -> &Run {
        let mut runs: Vec<&Run> = self.profiled.iter().collect();
        runs.sort_by_key(|run| run.update());
        runs[(runs.len() - 1) / 2]
    }

    fn part(&self, phase: &'static str, time: Duration) -> Part {
        let run = self.profile();
        Part {
            phase,
            ms: ms(time),
            share: time.div_duration_f64(run.update().max(Duration::from_nanos(1))),
            mean_us: 1e3 * ratio(ms(time), run.units()),
        }
    }

    fn phases(&self) -> Vec<Part> {
        let profile = self.profile().profile;
        let part = |phase: Phase| self.part(phase.name(), profile.time(phase));
        Phase::ALL.into_iter().map(part).collect()
    }

    fn outside(&self) -> Part {
        let run = self.profile();
        self.part("outside", run.update().saturating_sub(run.profile.total()))
    }

    fn report(&self) -> Result<Value, Error> {
        let Self { arguments, .. } = self;
        let run = self.last();
        let objective = run.objective;
        let graph = run.replayer.graph();
        let priors = run.replayer.replay().gauge_priors().len();
        let mut settings = arguments.solving.json(arguments.start(), &self.settings)?;
        settings["reading"] = arguments.reading.json();
        settings["max_steps"] = json!(arguments.max_steps);
        let mut report = json!({
            "schema": SCHEMA,
            "command": "bench",
            "dataset": report::file_name(&arguments.file),
            "mode": if arguments.batch { "batch" } else { "replay" },
            "repeats": arguments.repeats,
            "steps": run.replayer.poses(),
            "variables": graph.variable_count(),
            "factors": graph.factor_count() - priors,
            "settings": settings,
            "convention": CONVENTION,
            "error": objective.error,
            "chi2": objective.chi2,
            "time": self.times(),
            "reading_s": self.reading.as_secs_f64(),
            "cliques_eliminated": run.cliques_eliminated,
            "relinearizations": run.relinearizations,
            "profile": {
                "update_ms": ms(self.profile().update()),
                "phases": self.phases(),
                "outside": self.outside(),
            },
            "peak_rss_mb": report::peak_rss_mb(),
        });
        if let Some(batch) = &run.batch {
            report["batch"] = serde_json::to_value(batch)?;
        } else {
            report["cliques_per_step"] = json!(ratio(run.cliques_eliminated as f64, run.units()));
        }
        Ok(report)
    }

    fn table(&self) -> Rows {
        let run = self.last();
        let times = self.times();
        let mut rows = Rows::new("data set", &report::file_name(&self.arguments.file));
        rows.add("repeats", self.arguments.repeats);
        rows.add("threads", self.settings.threads);
        rows.add("steps (poses)", run.replayer.poses());
        rows.add("error", number(run.objective.error));
        rows.add("reading (once)", milliseconds(ms(self.reading)));
        rows.add("update time", times.update());
        match &run.batch {
            Some(batch) => {
                let how = serde_json::to_value(batch.status).unwrap_or_default();
                let how = how["status"].as_str().unwrap_or_default().replace('_', " ");
                rows.add("  iterations", format!("{}, {how}", batch.iterations));
            }
            None => {
                rows.add("  a step", times.steps());
                let cliques = ratio(run.cliques_eliminated as f64, run.units());
                rows.add("cliques eliminated", format!("{cliques:.2} a step"));
                rows.add("relinearizations", format!("{} variables", run.relinearizations));
            }
        }
        rows.add("update time, profiled", milliseconds(ms(self.profile().update())));
        rows
    }

    fn profile_table(&self) -> Columns {
        let each = format!("us / {}", self.arguments.unit());
        let mut table = Columns::new(["phase", "ms", "share", &each]);
        for part in self.phases().into_iter().chain([self.outside()]) {
            table.add([
                part.phase.to_string(),
                format!("{:.3}", part.ms),
                format!("{:.1} %", 100.0 * part.share),
                format!("{:.3}", part.mean_us),
            ]);
        }
        table
    }
}

fn ms(time: Duration) -> f64 {
    1e3 * time.as_secs_f64()
}

/// A share of nothing is nothing.
fn ratio(sum: f64, count: usize) -> f64 {
    if count == 0 { 0.0 } else { sum / count as f64 }
}
