#!/usr/bin/env bash
# Write a substitute for python:3.11-slim-bookworm from this machine's own files, for machines without
# access to a registry: the unchanged Dockerfile then builds from the wheels in the substitute.
# usage (root, Debian): tests/compose/base-image.sh WHEELS OUT.tar
set -euo pipefail
wheels=$1 out=$2
python=$(python3.11 -c 'import sys; print(sys.base_prefix)')
root=$(mktemp -d)
trap 'rm -rf "$root" "$root.files"' EXIT

# Contents of such an image: the essential packages, and the libraries of Python.
packages=$(dpkg-query -Wf '${Package} ${Essential}\n' | awk '$2 == "yes" {print $1}')
libraries="libc6 libssl3 libffi8 zlib1g libbz2-1.0 liblzma5 libsqlite3-0 libreadline8 libtinfo6
  libncursesw6 libuuid1 libexpat1 libcrypt1 libselinux1 libpcre2-8-0 libacl1 libattr1 libgmp10 libcap2
  libmd0 libzstd1 liblz4-1 libaudit1 libcap-ng0 libdb5.3 libpam0g libblkid1 libmount1 libsmartcols1
  libsystemd0 libgcc-s1 libstdc++6 libudev1 libnsl2 libtirpc3 libgssapi-krb5-2 libkrb5-3 libk5crypto3
  libkrb5support0 libcom-err2 libkeyutils1 libgomp1 ca-certificates openssl netbase tzdata passwd
  libsemanage2 libsepol2 libsemanage-common libbsd0"
for package in $packages $libraries; do
  dpkg -L "$package" 2>/dev/null || true
done | grep -vE '^/usr/share/(doc|man|locale|info|lintian)/|^/(root|proc|sys|dev|tmp)' | sort -u |
  while read -r file; do
    if [ -f "$file" ] || [ -L "$file" ]; then printf '%s\n' "$file"; fi
  done | sed -E 's#^/(bin|sbin|lib|lib64)/#/usr/\1/#; s#^/##' | sort -u >"$root.files"

mkdir -p "$root"/{proc,sys,dev,tmp,root,run,var/tmp,etc/ld.so.conf.d,opt/wheels} \
  "$root"/usr/{bin,sbin,lib,lib64,local/bin,local/lib}
chmod 1777 "$root/tmp" "$root/var/tmp"
for folder in bin sbin lib lib64; do ln -s "usr/$folder" "$root/$folder"; done
tar -C / -cf - --ignore-failed-read -T "$root.files" 2>/dev/null | tar -C "$root" -xf -
cp -a /usr/lib/"$(uname -m)"-linux-gnu/lib{ssl,crypto,ffi,z,bz2,lzma,sqlite3}.so* \
  "$root/usr/lib/$(uname -m)-linux-gnu/" 2>/dev/null || true
tar -C "$python" -cf - --exclude=__pycache__ --exclude='lib/python3.11/test' \
  --exclude='lib/python3.11/site-packages' --exclude='lib/python3.11/config-*' --exclude='*.a' \
  --exclude='lib/python3.11/idlelib' --exclude='lib/python3.11/tkinter' bin/python3.11 lib |
  tar -C "$root/usr/local" -xf -
mkdir -p "$root/usr/local/lib/python3.11/site-packages"
cp "$python"/lib/python3.11/ensurepip/_bundled/*.whl "$wheels"/*.whl "$root/opt/wheels/"
ln -s python3.11 "$root/usr/local/bin/python3"
ln -s python3 "$root/usr/local/bin/python"
for file in passwd group nsswitch.conf debian_version os-release; do
  cp -aL "/etc/$file" "$root/etc/" 2>/dev/null || true
done
echo /usr/local/lib >"$root/etc/ld.so.conf.d/local.conf"
echo 'include /etc/ld.so.conf.d/*.conf' >"$root/etc/ld.so.conf"
cp /etc/ld.so.conf.d/"$(uname -m)"* "$root/etc/ld.so.conf.d/" 2>/dev/null || true
chroot "$root" ldconfig
tar -C "$root" --numeric-owner -cf "$out" .
