; Home positions, one joint at a time, and where a motion is going.
; after: away = 15 +- 0.05
; after: at.home = 0 +- 0.05
; after: aim = 15 +- 0.01
; after: far = -1
; after: by.joints = 15 +- 0.01
.PROGRAM main()
  HOME
  BREAK
  SPEED 50 ALWAYS
  DRIVE 6,15,100
  aim=DEXT(#DEST,6)-DEXT(#HOME(1),6)
  POINT .d=DEST
  far=(DISTANCE(.d,HERE)<1)
  BREAK
  away=DEXT(#HERE,6)-DEXT(#HOME,6)
  HERE #stand
  by.joints=DEXT(#stand,6)-DEXT(#HOME(1),6)
  HOME 1
  BREAK
  at.home=DEXT(#HERE,6)-DEXT(#HOME(1),6)
.END
