# A recipe for Yocto that installs the package as it is; untried. It lies beside a folder `bateleur` with the .deb files.
SUMMARY = "Time- and space-partitioned executive and its flight control unit"
LICENSE = "MIT | Apache-2.0"
LIC_FILES_CHKSUM = "file://${COMMON_LICENSE_DIR}/MIT;md5=0835ade698e0bcf8506ecda2f7b4f302 \
                    file://${COMMON_LICENSE_DIR}/Apache-2.0;md5=89aea4e17d99a7cacdbeed46a0096b10"
PV = "0.1.0"

PACKAGE_DEB_ARCH:aarch64 = "arm64"
PACKAGE_DEB_ARCH:x86-64 = "amd64"
SRC_URI = "file://bateleur_${PV}_${PACKAGE_DEB_ARCH}.deb;subdir=${BP}"
COMPATIBLE_HOST = "(aarch64|x86_64).*-linux"

# Unpacks to what is installed, and installs that.
inherit bin_package systemd
SYSTEMD_SERVICE:${PN} = "bateleur.service"
# The unit is for whoever has written the plan of the machine.
SYSTEMD_AUTO_ENABLE = "disable"
RDEPENDS:${PN} = "glibc libgcc"
CONFFILES:${PN} = "${sysconfdir}/bateleur"
# Programs are stripped, and built with another toolchain.
INSANE_SKIP:${PN} = "already-stripped ldflags"
INHIBIT_PACKAGE_STRIP = "1"
