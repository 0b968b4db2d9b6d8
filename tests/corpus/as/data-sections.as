; What a backup brings along: reals, strings, integers, places, joint values.
; after: copies = 12
; after: $who = "line 3"
; after: @lot = 70000
; after: z = 30
; after: j6 = 60
; after: arr = 4.5
.PROGRAM main()
  copies=pieces*2
  $who=$station
  z=DZ(rack)
  j6=DEXT(#safe,6)
  arr=gap[2]
.END
.REALS
pieces = 6
gap[2] = 4.5
.END
.STRINGS
$station = "line 3"
.END
.INTEGER
@lot = 70000
.END
.TRANS
rack 10 20 30 0 180 0
.END
.JOINTS
#safe 10 20 -30 40 -50 60
.END
.SYSDATA
SWITCH CP ON
.END
