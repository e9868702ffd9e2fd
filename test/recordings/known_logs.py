"""Tables for which a mapping is proposed: of racing loggers, engine loggers, telephones and laboratories."""

from __future__ import annotations

import numpy as np

from recordings.logs import (
    Columns,
    G,
    Log,
    constant,
    counted,
    dates,
    degrees,
    held,
    kmh,
    laps,
    milliseconds,
    one_value_a_row,
    repeated_header,
    rim,
    spreadsheet,
    text_table,
    unix,
    vbo,
)  # fmt: skip

PLACE = ("latitude", "longitude", "altitude")
_GNSS = (*PLACE, "speed", "course")
WHEELS = ("fl", "fr", "rl", "rr")

RACING = {
    "Racelogic VBO": Log(
        vbo(
            ("vert-vel", "Longitudinal_Acc", "Lateral_Acc", "Yaw_Rate", "Steering_Angle"),
            lambda d: (constant(d, 0), d["ax"] / G, -d["ay"] / G, -degrees(d, "wz"), -degrees(d, "steering")),
        ),
        (*_GNSS, "ax", "ay", "wz", "steering"),
    ),
    "RaceBox VBO": Log(
        vbo(
            ("LongAcc", "LatAcc", "x-rotation-gyroscope", "y-rotation-gyroscope", "z-rotation-gyroscope"),
            lambda d: (d["ax"] / G, d["ay"] / G, degrees(d, "wx"), degrees(d, "wy"), degrees(d, "wz")),
        ),
        (*_GNSS, "ax", "ay", "wz"),
    ),
    "VBOX Test Suite": Log(
        text_table(
            "vbox.csv",
            lambda d: {
                "Elapsed time (s)": d["t"], "Latitude (°)": d["latitude"], "Longitude (°)": d["longitude"],
                "Speed (km/h)": kmh(d), "Heading (°)": d["course"], "Height (m)": d["altitude"],
                "Longitudinal acceleration (g)": d["ax"] / G, "Lateral acceleration (g)": d["ay"] / G,
                "Yaw rate (°/s)": degrees(d, "wz"),
            },
            decimals=9,
        ),
        (*_GNSS, "ax", "ay", "wz"), None,
    ),
    "RaceChrono": Log(
        text_table(
            "racechrono.csv",
            lambda d: {
                "timestamp|unix time": unix(d), "fragment_id|": counted(d), "lap_number|": constant(d, 1),
                "elapsed_time|s": d["t"], "distance_traveled|m": 14 * d["t"], "accuracy|m": constant(d, 0.5),
                "altitude|m": d["altitude"], "bearing|deg": d["course"], "fix_type|": constant(d, 3),
                "latitude|deg": d["latitude"], "longitude|deg": d["longitude"], "satellites|sats": constant(d, 12),
                "speed|m/s": d["speed"], "lateral_acc|G": d["ay"] / G, "lean_angle|deg": constant(d, 0),
                "longitudinal_acc|G": d["ax"] / G, "again": ("speed|m/s", d["speed"]),
                "z_rate_of_rotation|deg/s": degrees(d, "wz"),
            },
            above=("This file is created using RaceChrono v9.1.3 ( http://racechrono.com/ ).", "Format,3",
                   'Session title,"Lap"', "Session type,Lap timing", "Created,27/10/2024,14:59", ""),
            units=True, decimals=9,
            then=lambda lines: [*lines[:8], ",,,calc,,gps,gps,gps,gps,gps,gps,gps,gps,calc,calc,calc,calc,gyro",
            *lines[8:]],
        ),
        (*_GNSS, "ax", "ay", "wz"),
    ),
    "AiM Race Studio": Log(
        text_table(
            "aim.csv",
            lambda d: {
                "Time|s": d["t"], "GPS Speed|km/h": kmh(d), "GPS Nsat|#": constant(d, 12), "GPS LatAcc|g": d["ay"] / G,
                "GPS LonAcc|g": d["ax"] / G, "GPS Heading|deg": d["course"], "GPS Gyro|deg/s": degrees(d, "wz"),
                "GPS Altitude|m": d["altitude"], "GPS Latitude|deg": d["latitude"], "GPS Longitude|deg": d["longitude"],
                "Steering Angle|deg": degrees(d, "steering"), "LF_Shock|mm": constant(d, 20),
            },
            above=('"Format","AiM CSV File"', '"Session","Test"', '"Vehicle","Car"', '"Sample Rate","50"',
                   '"Date","Sunday, October 27, 2024"', '"Time","2:59:54 PM"', ""),
            units=True, blank=True, quoted=True, decimals=9,
        ),
        (*_GNSS, "ax", "ay", "wz", "steering"),
    ),
    "AiM, saved by a spreadsheet": Log(
        text_table(
            "aim.csv",
            lambda d: {
                "Time|s": d["t"], "GPS Speed|km/h": kmh(d), "GPS Heading|deg": d["course"],
                "GPS Latitude|deg": d["latitude"], "GPS Longitude|deg": d["longitude"],
            },
            above=("Format,AiM CSV File", "Session,Test", 'Date,"Sunday, October 27, 2024"', "Time,2:59:54 PM", ""),
            units=True, blank=True, decimals=9, then=spreadsheet,
        ),
        ("latitude", "longitude", "speed", "course"),
    ),
    "MoTeC i2": Log(
        text_table(
            "motec.csv",
            lambda d: {
                "Time|s": d["t"], "Distance|m": 14 * d["t"], "Ground Speed|km/h": kmh(d),
                "Engine RPM|rpm": constant(d, 4e3),
                "Steered Angle|deg": degrees(d, "steering"), "G Force Lat|G": d["ay"] / G,
                "G Force Long|G": d["ax"] / G,
                "Gyro Yaw Velocity|deg/s": degrees(d, "wz"), "Wheel Speed FL|km/h": rim(d, "fl"),
                "Wheel Speed FR|km/h": rim(d, "fr"), "Wheel Speed RL|km/h": rim(d, "rl"),
                "Wheel Speed RR|km/h": rim(d, "rr"),
            },
            above=('"Format","MoTeC CSV File","","","Workbook","wb"', '"Venue","Track","","","Worksheet",""',
                   '"Log Date","27/10/2024","","","Origin Time","0","s"', '"Sample Rate","50.000","Hz"', "", ""),
            units=True, blank=True, quoted=True,
        ),
        ("speed", "steering", "ax", "ay", "wz", *WHEELS), None,
    ),
    "TrackAddict": Log(
        text_table(
            "trackaddict.csv",
            lambda d: {
                "Time": d["t"], "UTC Time": unix(d), "Lap": constant(d, 0), "Latitude": d["latitude"],
                "Longitude": d["longitude"], "Altitude (m)": d["altitude"], "Altitude (ft)": d["altitude"] / 0.3048,
                "Speed (MPH)": d["speed"] / 0.44704, "Speed (Km/h)": kmh(d), "Heading": d["course"],
                "Accuracy (m)": constant(d, 5), "Brake (calculated)": constant(d, 0),
            },
            above=("# RaceRender Data: TrackAddict 4.6.0 on Android 8.0.0", "# Vehicle: Car", "# Mode: Track Session"),
            quoted=True, decimals=9, then=laps,
        ),
        _GNSS,
    ),
    "Harry's LapTimer": Log(
        text_table(
            "laptimer.csv",
            lambda d: {
                "INDEX": counted(d), "LAPINDEX": constant(d, 1), "DATE": dates(d, "%d-%b-%y"),
                "TIME": milliseconds(d, "%H:%M:%S.%f"), "TIME_LAP": d["t"], "LATITUDE": d["latitude"],
                "LONGITUDE": d["longitude"], "SPEED_KPH": kmh(d), "SPEED_MPH": d["speed"] / 0.44704,
                "HEIGHT_METER": d["altitude"], "HEADING_DEG": d["course"], "LATERALG": d["ay"] / G,
                "LINEALG": d["ax"] / G,
            },
            above=("LapTimer Export",), decimals=9,
        ),
        ("latitude", "longitude", "speed", "course"), None,
    ),
}  # fmt: skip

ENGINE = {
    "Torque": Log(
        text_table(
            "torque.csv",
            lambda d: {
                "GPS Time": dates(d, "%a %b %d %H:%M:%S GMT+00:00 %Y"),
                " Device Time": milliseconds(d, "%d-%b-%Y %H:%M:%S.%f"), " Longitude": d["longitude"],
                " Latitude": d["latitude"], "GPS Speed (Meters/second)": d["speed"],
                " Horizontal Dilution of Precision": constant(d, 4), " Altitude": d["altitude"],
                " Bearing": d["course"],
                "Engine RPM(rpm)": constant(d, 2000), "Speed (OBD)(km/h)": np.round(kmh(d)),
            },
            decimals=9, then=repeated_header,
        ),
        _GNSS,
    ),
    "Car Scanner": Log(one_value_a_row, ("speed", "steering"), None),
    "RomRaider": Log(
        text_table(
            "romraider.csv",
            lambda d: {
                "Time (msec)": np.round(d["t"] * 1000), "Engine Speed (rpm)": constant(d, 3000),
                "Vehicle Speed (km/h)": kmh(d), "Throttle Opening Angle (%)": constant(d, 20),
            },
            delimiter=";", decimal=",", decimals=4,
        ),
        ("speed",), None,
    ),
    "BlueDriver": Log(
        text_table(
            "bluedriver.csv",
            lambda d: {"Time (s)": d["t"], "Vehicle Speed (mph)": d["speed"] / 0.44704,
            "Engine RPM (RPM)": constant(d, 2e3)},
            encoding="utf-16",
        ),
        ("speed",), None,
    ),
    "COBB Accessport": Log(
        text_table(
            "cobb.csv",
            lambda d: {
                "Time (sec)": d["t"], "Vehicle Speed (mph)": d["speed"] / 0.44704, "RPM (RPM)": constant(d, 3000),
                "Steering Wheel Angle (°)": degrees(d, "steering"), "AP Info:[AP3-FOR-001 v1.7]": constant(d, 0),
            },
        ),
        ("speed", "steering"), None,
    ),
    "HP Tuners": Log(
        text_table(
            "hptuners.csv",
            lambda d: {
                "Offset|s": d["t"], "Vehicle Speed (SAE)|km/h": kmh(d), "Engine RPM (SAE)|rpm": constant(d, 2500),
                "Steering Wheel Angle|°": degrees(d, "steering"), "Yaw Rate|°/s": degrees(d, "wz"),
                "Lateral Acceleration|m/s²": d["ay"],
            },
            above=("HP Tuners CSV Log File - Export", "Version: 1.0", "", "[Log Information]",
                   "Creation Time: 10/27/2024 2:59:54 PM", "", "[Channel Information]", "0,13,12,44136,44137,44138"),
            units=True, then=lambda lines: [*lines[:10], "", "[Channel Data]", *lines[10:]],
        ),
        ("speed", "steering", "wz", "ay"), None,
    ),
    "German engine logger": Log(
        text_table(
            "messung.csv",
            lambda d: {
                "Zeit [ms]": np.round(d["t"] * 1000), "Geschwindigkeit [km/h]": kmh(d),
                "Lenkradwinkel [°]": degrees(d, "steering"), "Gierrate [°/s]": degrees(d, "wz"),
                "Querbeschleunigung [m/s²]": d["ay"], "Längsbeschleunigung [m/s²]": d["ax"],
                "Radgeschwindigkeit VL [km/h]": rim(d, "fl"), "Radgeschwindigkeit VR [km/h]": rim(d, "fr"),
                "Radgeschwindigkeit HL [km/h]": rim(d, "rl"), "Radgeschwindigkeit HR [km/h]": rim(d, "rr"),
            },
            delimiter=";", decimal=",", encoding="cp1252",
        ),
        ("speed", "steering", "wz", "ay", "ax", *WHEELS), None,
    ),
}  # fmt: skip


def phone(d: Columns, letter: str) -> dict[str, np.ndarray]:
    """The axes of a telephone that lies with its screen up and its upper edge forward: right, forward, up."""
    return {"x": -d[f"{letter}y"], "y": d[f"{letter}x"], "z": d[f"{letter}z"]}


PHONES = {
    "Sensor Logger, location": Log(
        text_table(
            "Location.csv",
            lambda d: {
                "time": [f"{1_730_041_194_000_000_000 + round(t * 1e9)}" for t in d["t"]], "seconds_elapsed": d["t"],
                "bearingAccuracy": constant(d, 1), "speedAccuracy": constant(d, 0.2),
                "verticalAccuracy": constant(d, 3),
                "horizontalAccuracy": constant(d, 3), "speed": d["speed"], "bearing": d["course"],
                "altitude": d["altitude"], "longitude": d["longitude"], "latitude": d["latitude"],
            },
            decimals=9,
        ),
        _GNSS, 1_730_041_194.0,
    ),
    "SensorLog": Log(
        text_table(
            "sensorlog.csv",
            lambda d: {
                "loggingTime(txt)": milliseconds(d, "%Y-%m-%dT%H:%M:%S.%f"), "loggingSample(N)": counted(d),
                "locationTimestamp_since1970(s)": unix(d), "locationLatitude(WGS84)": d["latitude"],
                "locationLongitude(WGS84)": d["longitude"], "locationAltitude(m)": d["altitude"],
                "locationSpeed(m/s)": d["speed"], "locationCourse(°)": d["course"],
                **{f"gyroRotation{axis.upper()}(rad/s)": v for axis, v in phone(d, "w").items()},
            },
            decimals=9,
            then=lambda lines: [lines[0], *(line.replace(",", "+00:00,", 1) for line in lines[1:])],
        ),
        (*_GNSS, "wz"),
    ),
    "phyphox": Log(
        text_table(
            "phyphox.csv",
            lambda d: {
                "Time (s)": d["t"], "Latitude (°)": d["latitude"], "Longitude (°)": d["longitude"],
                "Height (m)": d["altitude"], "Velocity (m/s)": d["speed"], "Direction (°)": d["course"],
                "Horizontal Accuracy (m)": constant(d, 3), "Vertical Accuracy (m)": constant(d, 4),
            },
            quoted=False, decimals=9,
        ),
        _GNSS, None,
    ),
    "AndroSensor": Log(
        text_table(
            "androsensor.csv",
            lambda d: {
                **{f"ACCELEROMETER {axis.upper()} (m/s²)": v for axis, v in phone(d, "a").items()},
                **{f"GYROSCOPE {axis.upper()} (rad/s)": v for axis, v in phone(d, "w").items()},
                "LOCATION Latitude : ": d["latitude"], "LOCATION Longitude : ": d["longitude"],
                "LOCATION Altitude ( m)": d["altitude"], "LOCATION Speed ( Kmh)": kmh(d),
                "LOCATION Accuracy ( m)": constant(d, 3), "LOCATION ORIENTATION (°)": d["course"],
                "Satellites in range": ["9 / 12"] * len(d["t"]), "Time since start in ms ": np.round(d["t"] * 1000),
                "YYYY-MO-DD HH-MI-SS_SSS": milliseconds(d, "%Y-%m-%d %H:%M:%S:%f"),
            },
            delimiter=";", decimals=9,
        ),
        (*_GNSS, "wz", "az"), None,
    ),
}  # fmt: skip

LABORATORY = {
    "OXTS NAVgraph": Log(
        text_table(
            "oxts.csv",
            lambda d: {
                "Time (s)": d["t"], "Latitude (deg)": d["latitude"], "Longitude (deg)": d["longitude"],
                "Altitude (m)": d["altitude"], "Speed 2D (m/s)": d["speed"], "Track 2D (deg)": d["course"],
                "Acceleration Xv (m/s²)": d["ax"], "Acceleration Yv (m/s²)": -d["ay"],
                "Acceleration Zv (m/s²)": -d["az"],
                "Angular rate Xv (deg/s)": degrees(d, "wx"), "Angular rate Yv (deg/s)": -degrees(d, "wy"),
                "Angular rate Zv (deg/s)": -degrees(d, "wz"),
            },
            decimals=9,
        ),
        (*_GNSS, "ax", "ay", "az", "wz"), None,
    ),
    "CarMaker": Log(
        text_table(
            "carmaker.txt",
            lambda d: {
                "Time [s]": d["t"], "Car.v [m/s]": d["speed"], "Car.ax [m/s^2]": d["ax"], "Car.ay [m/s^2]": d["ay"],
                "Car.YawRate [rad/s]": d["wz"], "Steer.WhlAng [rad]": d["steering"],
                **{f"Car.Wheel{w.upper()}.rotv [rad/s]": d[w] for w in WHEELS},
            },
            delimiter="\t",
        ),
        ("speed", "ax", "ay", "wz", "steering", *WHEELS), None,
    ),
    "PlotJuggler": Log(
        text_table(
            "plotjuggler.csv",
            lambda d: {
                "__time": unix(d), "/imu/data/angular_velocity/x": d["wx"], "/imu/data/angular_velocity/y": d["wy"],
                "/imu/data/angular_velocity/z": d["wz"], "/imu/data/linear_acceleration/x": d["ax"],
                "/imu/data/linear_acceleration/y": d["ay"], "/imu/data/linear_acceleration/z": d["az"],
                "/gps/fix/latitude": d["latitude"], "/gps/fix/longitude": d["longitude"],
                "/gps/fix/altitude": d["altitude"],
            },
            decimals=9,
        ),
        (*PLACE, "wz", "ax", "ay", "az"),
    ),
    "rostopic echo -p": Log(
        text_table(
            "imu.csv",
            lambda d: {
                "%time": [f"{1_730_041_194_000_000_000 + round(t * 1e9)}" for t in d["t"]],
                "field.header.seq": counted(d),
                "field.header.frame_id": ["imu_link"] * len(d["t"]), "field.orientation.x": constant(d, 0),
                "field.orientation.w": constant(d, 1), "field.angular_velocity.x": d["wx"],
                "field.angular_velocity.y": d["wy"], "field.angular_velocity.z": d["wz"],
                "field.linear_acceleration.x": d["ax"], "field.linear_acceleration.y": d["ay"],
                "field.linear_acceleration.z": d["az"],
            },
        ),
        ("wz", "ax", "ay", "az"), 1_730_041_194.0,
    ),
    "Xsens MT Manager": Log(
        text_table(
            "mt.txt",
            lambda d: {
                "PacketCounter": counted(d), "SampleTimeFine": np.round(d["t"] * 1e4), "Acc_X": d["ax"],
                "Acc_Y": d["ay"],
                "Acc_Z": d["az"], "Gyr_X": d["wx"], "Gyr_Y": d["wy"], "Gyr_Z": d["wz"], "Latitude": d["latitude"],
                "Longitude": d["longitude"], "Altitude": d["altitude"],
            },
            above=("// General information:", "//  MT Manager version: 2022.0.0", "//  Update Rate: 50.0Hz"),
            delimiter="\t", decimals=9,
        ),
        (*PLACE, "ax", "ay", "az", "wz"), None,
    ),
    "days of a spreadsheet": Log(
        text_table(
            "excel.csv",
            lambda d: {
                "Timestamp": [f"{45592.6249305556 + t / 86400:.10f}" for t in d["t"]], "Speed [km/h]": kmh(d),
                "Yaw rate [deg/s]": degrees(d, "wz"), "Steering wheel angle [deg]": degrees(d, "steering"),
            },
        ),
        ("speed", "wz", "steering"),
    ),
    "12-hour clock": Log(
        text_table(
            "us.csv",
            lambda d: {
                "Date/Time": milliseconds(d, "%m/%d/%Y %I:%M:%S.%f"), "Vehicle Speed [mph]": d["speed"] / 0.44704,
                "Latitude": d["latitude"], "Longitude": d["longitude"],
            },
            decimals=9, then=lambda lines: [lines[0], *(line.replace(",", " PM,", 1) for line in lines[1:])],
        ),
        ("latitude", "longitude", "speed"),
    ),
    "held fixes in a fast table": Log(
        text_table(
            "held.csv",
            lambda d: {
                "time [s]": d["t"], "yaw rate [rad/s]": d["wz"], "lat [deg]": held(d["latitude"], 5),
                "lon [deg]": held(d["longitude"], 5), "gps speed [m/s]": held(d["speed"], 5),
                "gps course [deg]": held(d["course"], 5),
            },
            decimals=9,
        ),
        ("latitude", "longitude", "speed", "course", "wz"), None,
    ),
}  # fmt: skip

LOGS = RACING | ENGINE | PHONES | LABORATORY
