#!/bin/sh
# Counts the instructions of `evergraph replay`: unlike times, they are the same on a busy machine.
#
#     EVERGRAPH_DATA=/path/to/data benches/callgrind.sh [FILE...]
#
# Needs valgrind, and minutes: it runs some fifty times slower, and without AVX-512. Functions are listed
# by the file that their instructions come from; the dense kernels run below pulp's `vectorize`. TOP=N
# lists N of them (20), STEPS=N stops each replay after N steps, KEEP=FOLDER keeps what callgrind wrote.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
target=${CARGO_TARGET_DIR:-$root/target}
top=${TOP:-20}

command -v valgrind > /dev/null || { echo "callgrind.sh: valgrind is not installed" >&2; exit 1; }
if [ $# -eq 0 ]; then
    : "${EVERGRAPH_DATA:?names the folder of the data sets; or name files to replay}"
    set -- "$EVERGRAPH_DATA/pose2d/manhattanOlson3500.txt" "$EVERGRAPH_DATA/pose3d/sphere2500.g2o"
fi
for file; do
    [ -f "$file" ] || { echo "callgrind.sh: there is no $file" >&2; exit 1; }
done
cargo build --release -p evergraph-cli --manifest-path "$root/Cargo.toml"

folder=${KEEP:-$(mktemp -d)}
mkdir -p "$folder"
[ -n "${KEEP:-}" ] || trap 'rm -rf "$folder"' EXIT

rows="$folder/rows.md"
: > "$rows"
for file; do
    name=$(basename "$file")
    out="$folder/$name.callgrind"
    # Only what runs below `Smoother::apply` is counted: not reading, not the report.
    valgrind --tool=callgrind --callgrind-out-file="$out" --dump-instr=no \
        --toggle-collect='*smoother::Smoother::apply' \
        "$target/release/evergraph" replay "$file" --threads 1 --quiet \
        ${STEPS:+--max-steps "$STEPS"} --report "$folder/$name.json" 2> "$folder/$name.log" ||
        { cat "$folder/$name.log" >&2; exit 1; }
    steps=$(sed -n 's/^  "updates": \([0-9]*\),*$/\1/p' "$folder/$name.json")
    total=$(sed -n 's/^totals: \([0-9]*\).*/\1/p' "$out")
    [ "${total:-0}" -gt 0 ] || { echo "callgrind.sh: nothing was counted in $name" >&2; exit 1; }

    echo
    echo "$name: $steps steps, instructions of Smoother::apply by function"
    callgrind_annotate --auto=no --show-percs=yes "$out" |
        grep -E '^ *[0-9][0-9,]* +\( *[0-9.]+%\)' | grep -v 'PROGRAM TOTALS' |
        sed -E -e 's| \[/[^]]*\]$||' -e 's|/rustc/[0-9a-f]+/library/||' -e 's|/[^ ]*/registry/src/[^/]*/||' |
        head -n "$top"
    awk -v name="$name" -v steps="$steps" -v total="$total" 'BEGIN {
        printf "| %s | %d | %.1f | %.0f |\n", name, steps, total / 1e6, total / steps
    }' >> "$rows"
done

echo
echo "| data set | steps | instructions, millions | a step |"
echo "|---|---|---|---|"
cat "$rows"
