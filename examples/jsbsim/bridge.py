#!/usr/bin/env python3
"""Flies an aircraft of JSBSim for Bateleur, by the MAVLink link of docs/src/hil.md, in lockstep.

Listens, says where as one line of JSON, and answers each question: JSBSim is advanced to the time that is asked for, with the controls of
the question, and its sensors are measured there. Ends with its standard input, or at Ctrl-C, and says as a second line what was flown.
"""

import argparse
import json
import math
import os
import select
import socket
import sys
from pathlib import Path

os.environ.setdefault("JSBSIM_DEBUG", "0")  # it greets on standard output otherwise, as soon as it is loaded
import jsbsim
from pymavlink.dialects.v20 import common as mavlink

FT_M = 0.3048
PSF_HPA = 0.4788025898
RANKINE_K = 5.0 / 9.0
GRAVITY_MPS2 = 9.797
FIELD_NED_GAUSS = (0.09584, -0.04861, -0.22624)
LATITUDE_DEG, LONGITUDE_DEG = -34.0466050, 18.7402978
STEP_US = 2500
# A question that is later than this is a pause of the module, not a flight.
MOST_US = 1_000_000
FIX_US = 200_000
# An aircraft that stands with its throttle closed stands on its brakes.
IDLE, STANDING_MPS = 0.05, 2.0


def arguments():
    parser = argparse.ArgumentParser(description="Flies an aircraft of JSBSim for a flight computer that speaks MAVLink.")
    parser.add_argument("--listen", default="127.0.0.1:14560", help="address and port (UDP)")
    parser.add_argument("--aircraft", default="J3Cub", help="one that ships with JSBSim")
    parser.add_argument("--wind", type=float, default=0.0, help="m/s, steady")
    parser.add_argument("--wind-from", type=float, default=0.0, help="degrees clockwise from north")
    parser.add_argument("--track", type=Path, help="write time, north, east, height, airspeed here, as CSV")
    return parser.parse_args()


class Aircraft:
    """JSBSim on a runway that runs north, its engine idling."""

    def __init__(self, options):
        self.fdm = fdm = jsbsim.FGFDMExec(None)
        fdm.set_debug_level(0)
        if not fdm.load_model(options.aircraft):
            sys.exit(f"JSBSim has no aircraft {options.aircraft}")
        fdm.set_dt(STEP_US * 1e-6)
        fdm["ic/lat-geod-deg"], fdm["ic/long-gc-deg"] = LATITUDE_DEG, LONGITUDE_DEG
        fdm["ic/terrain-elevation-ft"] = 0.0
        fdm["ic/h-agl-ft"] = 5.0
        fdm["ic/psi-true-deg"] = 0.0
        fdm["ic/vt-fps"] = 0.0
        fdm.run_ic()
        fdm["propulsion/set-running"] = -1
        fdm["fcs/mixture-cmd-norm"] = 1.0
        towards = math.radians(options.wind_from + 180.0)
        fdm["atmosphere/wind-north-fps"] = options.wind * math.cos(towards) / FT_M
        fdm["atmosphere/wind-east-fps"] = options.wind * math.sin(towards) / FT_M
        self.control((0.0, 0.0, 0.0, 0.0))
        # It is set down on its wheels and rocks for a while.
        for _ in range(4000):
            fdm.run()
        # North and east count from where it came to rest.
        self.origin = (fdm["position/lat-geod-rad"], fdm["position/long-gc-rad"], fdm["position/h-sl-ft"])
        self.force, self.rates = self.forces(), self.turning()
        self.throttle = 0.0

    def control(self, controls):
        """Aileron, elevator, throttle, rudder as the link has them: positive rolls right, pitches down, yaws left."""
        fdm = self.fdm
        aileron, elevator, throttle, rudder = controls
        fdm["fcs/aileron-cmd-norm"], fdm["fcs/elevator-cmd-norm"] = aileron, elevator
        fdm["fcs/rudder-cmd-norm"], fdm["fcs/steer-cmd-norm"] = rudder, -rudder
        fdm["fcs/throttle-cmd-norm"] = self.throttle = throttle
        brakes = float(throttle < IDLE and fdm["velocities/vg-fps"] * FT_M < STANDING_MPS)
        fdm["fcs/left-brake-cmd-norm"] = fdm["fcs/right-brake-cmd-norm"] = brakes

    def attitude(self):
        return tuple(self.fdm[f"attitude/{angle}-rad"] for angle in ("phi", "theta", "psi"))

    def turning(self):
        return tuple(self.fdm[f"velocities/{rate}-rad_sec"] for rate in "pqr")

    def forces(self):
        """Specific force, body axes, m/s²: what an accelerometer in the centre of gravity feels. From the motion, so that wheels count too."""
        fdm, (phi, theta, _) = self.fdm, self.attitude()
        u, v, w = (fdm[f"velocities/{axis}-fps"] * FT_M for axis in "uvw")
        du, dv, dw = (fdm[f"accelerations/{axis}dot-ft_sec2"] * FT_M for axis in "uvw")
        p, q, r = self.turning()
        return (
            du + q * w - r * v + GRAVITY_MPS2 * math.sin(theta),
            dv + r * u - p * w - GRAVITY_MPS2 * math.cos(theta) * math.sin(phi),
            dw + p * v - q * u - GRAVITY_MPS2 * math.cos(theta) * math.cos(phi),
        )

    def fly(self, microseconds, controls):
        """Advances; forces and rates become the means over that time."""
        self.control(controls)
        steps = max(1, round(min(microseconds, MOST_US) / STEP_US))
        sums = [0.0] * 6
        for _ in range(steps):
            self.fdm.run()
            sums = [total + value for total, value in zip(sums, self.forces() + self.turning())]
        means = tuple(total / steps for total in sums)
        self.force, self.rates = means[:3], means[3:]

    def field(self):
        """The earth's field in body axes, gauss."""
        (phi, theta, psi), (n, e, d) = self.attitude(), FIELD_NED_GAUSS
        ahead, aside = n * math.cos(psi) + e * math.sin(psi), -n * math.sin(psi) + e * math.cos(psi)
        x, down = ahead * math.cos(theta) - d * math.sin(theta), ahead * math.sin(theta) + d * math.cos(theta)
        return x, aside * math.cos(phi) + down * math.sin(phi), -aside * math.sin(phi) + down * math.cos(phi)

    def height_m(self):
        return (self.fdm["position/h-sl-ft"] - self.origin[2]) * FT_M

    def place_m(self):
        """North and east of where it stood, by the radii of the earth there."""
        latitude, longitude, _ = self.origin
        flat = 6_378_137.0 / math.sqrt(1.0 - 0.00669437999 * math.sin(latitude) ** 2)
        along = flat * (1.0 - 0.00669437999) / (1.0 - 0.00669437999 * math.sin(latitude) ** 2)
        north = (self.fdm["position/lat-geod-rad"] - latitude) * along
        return north, (self.fdm["position/long-gc-rad"] - longitude) * flat * math.cos(latitude)

    def airspeed_mps(self):
        return self.fdm["velocities/vt-fps"] * FT_M


class Link:
    """Answers questions of the flight computer."""

    def __init__(self, aircraft, track):
        self.aircraft, self.track = aircraft, track
        self.encoder = mavlink.MAVLink(None, srcSystem=51, srcComponent=1)
        self.decoder = mavlink.MAVLink(None)
        self.decoder.robust_parsing = True
        self.time_us = None
        self.answer = b""
        self.fix_us = -FIX_US
        self.greatest_m = 0.0
        self.questions = 0

    def pack(self, message):
        data = message.pack(self.encoder)
        self.encoder.seq = (self.encoder.seq + 1) % 256
        return data

    def answers(self, data):
        for message in self.decoder.parse_buffer(data) or []:
            if message.get_type() == "HIL_ACTUATOR_CONTROLS":
                answer = self.respond(message.time_usec, message.controls)
                if answer:
                    yield answer

    def respond(self, asked_us, controls):
        if asked_us == self.time_us:
            return self.answer  # it was lost
        if self.time_us is not None:
            if asked_us < self.time_us:
                return None
            self.aircraft.fly(asked_us - self.time_us, controls[:4])
        self.time_us = asked_us
        self.questions += 1
        parts = []
        if asked_us - self.fix_us >= FIX_US:
            self.fix_us = asked_us
            parts.append(self.pack(self.fix()))
        parts.append(self.pack(self.sensors()))
        self.note()
        self.answer = b"".join(parts)
        return self.answer

    def sensors(self):
        fdm = self.aircraft.fdm
        return mavlink.MAVLink_hil_sensor_message(
            self.time_us, *self.aircraft.force, *self.aircraft.rates, *self.aircraft.field(),
            abs_pressure=fdm["atmosphere/P-psf"] * PSF_HPA, diff_pressure=fdm["aero/qbar-psf"] * PSF_HPA,
            pressure_alt=0.0, temperature=fdm["atmosphere/T-R"] * RANKINE_K - 273.15, fields_updated=0x1FFF,
        )

    def fix(self):
        fdm = self.aircraft.fdm
        north, east, down = (fdm[f"velocities/v-{axis}-fps"] * FT_M * 100.0 for axis in ("north", "east", "down"))
        return mavlink.MAVLink_hil_gps_message(
            time_usec=self.time_us, fix_type=3, lat=round(fdm["position/lat-geod-deg"] * 1e7),
            lon=round(fdm["position/long-gc-deg"] * 1e7), alt=round(fdm["position/h-sl-ft"] * FT_M * 1e3),
            eph=150, epv=250, vel=0, vn=round(north), ve=round(east), vd=round(down), cog=65535, satellites_visible=12,
        )

    def note(self):
        self.greatest_m = max(self.greatest_m, self.aircraft.height_m())
        if self.track and self.questions % 10 == 0:
            north, east = self.aircraft.place_m()
            values = (self.time_us * 1e-6, north, east, self.aircraft.height_m(), self.aircraft.airspeed_mps(), *self.aircraft.attitude())
            self.track.write(",".join(f"{value:.3f}" for value in values) + "\n")


def main():
    options = arguments()
    aircraft = Aircraft(options)
    track = options.track.open("w") if options.track else None
    if track:
        track.write("time_s,north_m,east_m,height_m,airspeed_mps,roll_rad,pitch_rad,yaw_rad\n")
    link = Link(aircraft, track)
    host, port = options.listen.rsplit(":", 1)
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind((host, int(port)))
    print(json.dumps({"listening": "%s:%d" % listener.getsockname()}), flush=True)
    try:
        while True:
            ready = select.select([sys.stdin, listener], [], [])[0]
            if sys.stdin in ready and not sys.stdin.readline():
                break
            if listener in ready:
                data, sender = listener.recvfrom(4096)
                for answer in link.answers(data):
                    listener.sendto(answer, sender)
    except KeyboardInterrupt:
        pass
    if track:
        track.close()
    north, east = aircraft.place_m()
    print(json.dumps({
        "aircraft": options.aircraft, "jsbsim": jsbsim.__version__, "flown_s": (link.time_us or 0) * 1e-6, "questions": link.questions,
        "greatest_height_m": round(link.greatest_m, 1), "north_m": round(north, 1), "east_m": round(east, 1),
    }), flush=True)


if __name__ == "__main__":
    main()
