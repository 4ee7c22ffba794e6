#!/bin/sh
# Builds the C library, and installs the header, the libraries and the pkg-config file in PREFIX.
#
#   readers/c/install.sh PREFIX
set -eu
prefix=${1:?PREFIX is missing; name the folder of the installation, such as /usr/local}
mkdir -p "$prefix"
prefix=$(cd "$prefix" && pwd)
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
cargo build --release --locked -p sightline-pvs-c
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
mkdir -p "$prefix/include" "$prefix/lib/pkgconfig"
cp readers/c/include/sightline_pvs.h "$prefix/include/"
for library in libsightline_pvs_c.a libsightline_pvs_c.so libsightline_pvs_c.dylib; do
    if [ -e "$target/release/$library" ]; then cp "$target/release/$library" "$prefix/lib/"; fi
done
sed -e "s|@PREFIX@|$prefix|" -e "s|@VERSION@|$version|" readers/c/sightline_pvs.pc.in \
    > "$prefix/lib/pkgconfig/sightline_pvs.pc"
echo "installed in $prefix; for the flags of the compiler, run pkg-config --cflags --libs sightline_pvs"
