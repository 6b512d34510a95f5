//! A window of ten poses.
#![allow(clippy::unwrap_used)]
use evergraph_factors::{BetweenPose2, Prior};
use evergraph_model::{Key, LieGroup, Noise, Pose2};
use evergraph_removal::*;
use evergraph_solver::{Settings, Smoother};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn gauss(r: &mut ChaCha8Rng) -> f64 {
    let (u, v): (f64, f64) = (r.random_range(1e-12..1.0), r.random_range(0.0..1.0));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

#[test]
fn experiment() {
    let steps: usize = std::env::var("STEPS").map_or(200, |s| s.parse().unwrap());
    let names = std::env::var("NAMES").unwrap_or("dense,auto,tree,cons,scaled,nl,nlcons".into());
    for name in names.split(',') {
        let tree = Options::default().with_topology(Topology::ChowLiu);
        let tree = if std::env::var("NOGUARD").is_ok() {
            tree.with_guard(
                Guard::default().with_rotation(f64::INFINITY).with_mahalanobis(f64::INFINITY),
            )
        } else {
            tree
        };
        let tree = if std::env::var("LIMIT").is_ok() {
            tree.with_mutual_information(MutualInformation::Limit)
        } else {
            tree
        };
        let opts = match name {
            "auto" => Options::default(),
            "dense" => Options::dense(),
            "tree" => tree,
            "cons" => tree.with_consistency(Consistency::Conservative),
            "scaled" => tree.with_consistency(Consistency::Scaled),
            "nl" => tree.with_recovery(Recovery::Nonlinear),
            "nlcons" => {
                tree.with_recovery(Recovery::Nonlinear).with_consistency(Consistency::Conservative)
            }
            _ => panic!(),
        };
        let n = Noise::from_sigmas(&[0.05, 0.05, 0.01]).unwrap();
        let mut rg = ChaCha8Rng::seed_from_u64(3);
        let mut s = Smoother::new(Settings::default()).unwrap();
        let mut k: Vec<Key<Pose2>> = vec![];
        let t = std::time::Instant::now();
        let mut out = String::new();
        let mut kinds = std::collections::BTreeMap::<String, usize>::new();
        let (mut falls, mut dense, mut blanket) = (0, 0, 0);
        for i in 0..=steps {
            let z = Pose2::new(
                1.0 + 0.05 * gauss(&mut rg),
                0.05 * gauss(&mut rg),
                0.1 + 0.01 * gauss(&mut rg),
            );
            let nz =
                Pose2::new(0.05 * gauss(&mut rg), 0.05 * gauss(&mut rg), 0.01 * gauss(&mut rg));
            let mut c = s.change();
            let g =
                if i == 0 { Pose2::identity() } else { s.estimate(k[i - 1]).unwrap().compose(&z) };
            k.push(c.add_variable(&g));
            if i > 0 {
                c.add_factor(BetweenPose2::new(k[i - 1], k[i], z, n.clone()).unwrap());
            } else {
                c.add_factor(
                    Prior::new(k[0], g, Noise::from_sigmas(&[0.1, 0.1, 0.1]).unwrap()).unwrap(),
                );
            }
            if i >= 8 {
                let m = s.estimate(k[i - 8]).unwrap().inverse().compose(&g).compose(&nz);
                c.add_factor(BetweenPose2::new(k[i - 8], k[i], m, n.clone()).unwrap());
            }
            s.apply(c).unwrap();
            if i >= 10 {
                let p = Removal::new(s.graph(), &s).with_options(opts).plan(k[i - 10]).unwrap();
                let step = &p.steps()[0];
                falls += usize::from(step.fallback.is_some());
                if let Some(f) = step.fallback {
                    *kinds.entry(format!("{f:?}")).or_default() += 1;
                }
                dense += usize::from(step.topology == Topology::Dense);
                blanket = step.blanket.len();
                if i < 34 && std::env::var("SHOW").is_ok() {
                    println!(
                        "{i} {:?} {:?}",
                        step.certificate,
                        step.added
                            .iter()
                            .map(|a| (a.variables.clone(), a.rows))
                            .collect::<Vec<_>>()
                    );
                }
                s.apply(p.into_change()).unwrap();
            }
            if [30, 100, 200, 400, 800, 1600, 3000, 10000, 30000, 100_000, 200_000].contains(&i) {
                let a = s.marginal(k[i].id()).unwrap();
                out += &format!(" {i}:{:.4}", a[(2, 2)].sqrt());
            }
        }
        println!(
            "{name:8}{out} | factors {} falls {falls} dense {dense} blanket {blanket} {:.2?} {kinds:?}",
            s.graph().factor_count(),
            t.elapsed()
        );
    }
}
