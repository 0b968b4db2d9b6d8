.PROGRAM pl.main() ;robot program, process 3: EXECUTE pl.main. Commands, see README.md
  ; forcemesh, protocol plain: the specification to the letter, and none of the protection of
  ; forcemesh.as, which is the default. NO watchdog, NO limits, NO hold, NO hello: the table in
  ; docs/controller.md. This is not a safety function. It ends with pl.quit=1; after an abort
  ; EXECUTE pl.restore puts back what was changed.
  ; pl.main  process 3, robot program: commands 1 to 7; calls ForceFeedBackPosition and
  ;          ForceFeedBackOrientation (of a name AS reads 15 characters)
  ; pl.send  process 1, PC program 1: sends pose and joints without end
  ; pl.recv  process 2, PC program 2: characters to a buffer, the buffer to packets
  CALL pl.config
  CALL pl.begin
  IF pl.other<>0 GOTO other
  CALL pl.init
  TOOL NULL
  BASE NULL
  CP ON
  ABS.SPEED OFF ;the monitor speed scales every speed
  QTOOL OFF ;or the pendant would replace TOOL
  ACCURACY pl.accur ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  SPEED pl.v MM/S ALWAYS ;each motion brings its own
  PCEXECUTE 1: pl.send
  PCEXECUTE 2: pl.recv
turn:
  WAIT (pl.rh<>pl.rt) OR (pl.lost<>pl.seen) OR (pl.quit<>0) OR (pl.new*ABS(TIMER(3)>=pl.tnext)<>0)
  IF pl.lost<>pl.seen THEN ;the connection has ended: nothing continues
    BRAKE
    pl.seen=pl.lost
    pl.mode=0
    pl.new=0
  END
  WHILE pl.rh<>pl.rt DO
    CALL pl.take
  END
  IF (pl.new<>0) AND (TIMER(3)>=pl.tnext) THEN
    CALL pl.step
  END
  IF pl.quit==0 GOTO turn
  CALL pl.leave
  RETURN
other: ;never aborted: it may guard something else
  PRINT "forcemesh needs PC programs 1 and 2: another program is in",pl.other
.END
.PROGRAM pl.config() ;what may be changed: the numbers of gateway and gateway.plain in the cell file
  pl.port=49152 ;TCP port that is listened on, 8192 to 65535
  pl.w=7 ;characters of a number: 7 with the space after it, 6 without
  pl.sp=1 ;packet units per mm
  pl.so=1 ;per degree of O, A, T
  pl.sj=1 ;per degree of a joint
  pl.sf=1 ;per N
  pl.sm=1 ;per N m
  pl.sv=1 ;per mm/s
  pl.sc=1 ;per percent
  pl.sg=1 ;of proportional gains: per mm/N and per deg/(N m)
  pl.si=1 ;of integral gains: per mm/(N s) and per deg/(N m s)
  pl.tx=0 ;the point that ForceFeedBackOrientation turns about, in the flange frame [mm]
  pl.ty=0
  pl.tz=0
  pl.v=50 ;speed until command 5 comes [mm/s]
  pl.accur=10 ;ACCURACY of every motion [mm]
  pl.tsend=0.008 ;pause of process 1 between two samples [s]
  pl.dtmax=0.1 ;longest time that one reading is integrated over [s]
  pl.tmove=0.03 ;least time of a motion that blends into the next one [s]
  pl.vmin=1.2 ;slowest program speed that the controller keeps [mm/s]
  pl.lever=1.75 ;one degree of a turn counts as this many mm of way (100 mm/rad)
  pl.jmax[1]=370 ;speeds of the joints at 100 % [deg/s]; too small a number makes JMOVE faster
  pl.jmax[2]=310
  pl.jmax[3]=410
  pl.jmax[4]=550
  pl.jmax[5]=550
  pl.jmax[6]=1000
.END
.PROGRAM pl.begin() ;stop what an earlier run left; keep TOOL, BASE and switches for pl.leave
  CALL pl.end.pc
  IF EXISTREAL("pl.saved")==0 THEN
    pl.saved=0
  END
  POINT .a=TOOL
  DECOMPOSE .x[1]=.a
  .s=ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  POINT .a=BASE
  DECOMPOSE .x[1]=.a
  .s=.s+ABS(.x[1])+ABS(.x[2])+ABS(.x[3])+ABS(.x[5])+ABS(SIN((.x[4]+.x[6])/2))
  ; An aborted run leaves TOOL and BASE null and pl.saved set: then the ones it kept are right.
  IF (pl.saved==0) OR (.s>=0.001) THEN
    POINT pl.tool0=TOOL
    POINT pl.base0=BASE
    pl.cp0=ABS(SWITCH(CP))
    pl.abs0=ABS(SWITCH(ABS.SPEED))
    pl.qtool0=ABS(SWITCH(QTOOL))
    pl.saved=1
  END
.END
.PROGRAM pl.end.pc() ;end our PC programs and the connection; pl.other: where another program is
  pl.other=0
  IF TASK(1001)<>0 THEN
    IF WHICHTASK("pl.send")==1001 THEN
      PCABORT 1:
    ELSE
      pl.other=1
    END
  END
  IF TASK(1002)<>0 THEN
    IF WHICHTASK("pl.recv")==1002 THEN
      PCABORT 2:
    ELSE
      pl.other=2
    END
  END
  IF (pl.other<>0) OR (EXISTREAL("pl.sock")==0) GOTO clean
  TIMER 2=0
  WAIT ((TASK(1001)<>1) AND (TASK(1002)<>1)) OR (TIMER(2)>5)
  IF pl.sock>0 THEN
    TCP_CLOSE .r,pl.sock
  END
  TCP_END_LISTEN .r,pl.port
clean:
  pl.sock=0
.END
.PROGRAM pl.leave() ;end the PC programs and the connection, put back what was changed
  BREAK
  CALL pl.end.pc
  TOOL pl.tool0
  BASE pl.base0
  IF pl.cp0==0 THEN
    CP OFF
  END
  IF pl.abs0<>0 THEN
    ABS.SPEED ON
  END
  IF pl.qtool0<>0 THEN
    QTOOL ON
  END
  SPEED 100 ALWAYS ;the speeds cannot be read, so they get AS's defaults
  ACCURACY 1 ALWAYS
  ACCEL 100 ALWAYS
  DECEL 100 ALWAYS
  pl.saved=0
.END
.PROGRAM pl.restore() ;after an abort, if pl.main is not started again: EXECUTE pl.restore
  IF EXISTREAL("pl.saved")==0 GOTO none
  IF pl.saved==0 GOTO none
  CALL pl.leave
none:
  RETURN
.END
.PROGRAM pl.init() ;every global gets its value here
  pl.link=0 ;written by pl.recv. 1: connected, process 1 may send
  pl.lost=0 ;connections that have ended
  pl.framed=0 ;ID of the last packet on this connection
  pl.rh=0 ;ring of packets: next free slot
  pl.busy=0 ;written by pl.send. 1: inside TCP_SEND
  pl.drop=-1 ;the pl.lost of a connection that cannot be sent to
  pl.quit=0 ;a person may set it to 1: pl.main ends and puts everything back
  pl.rt=0 ;the rest is pl.main's. Ring: next slot to read
  pl.seen=0 ;the pl.lost that was obeyed
  pl.taken=0 ;ID of the last command
  pl.tkc=0 ;the pl.lost under which it came
  pl.mode=0 ;force feedback: 1 position + 2 orientation
  pl.new=0 ;1: a reading came for force feedback
  pl.first=0 ;1: the next reading is the first one
  pl.t0=0 ;TIMER(1) at the last iteration
  pl.tnext=0 ;TIMER(3) at which the next segment may be given
  pl.short=0 ;1: the last segment was too short to blend: BREAK comes before the next
  POINT pl.s0=NULL ;the end of the last segment
  POINT pl.from=NULL ;where a turn is measured from
  POINT pl.tcp=TRANS(pl.tx,pl.ty,pl.tz)
  POINT pl.p=NULL ;target
  POINT #pl.j=#HERE ;target of a joint motion
  FOR .i=1 TO 6
    pl.kp[.i]=0 ;gains of command 6
    pl.ki[.i]=0
    pl.f[.i]=0 ;reading of command 4 [N], [N m]
    pl.fb[.i]=0 ;the one before
  END
  FOR .i=1 TO 3
    pl.sr[.i]=pl.sp ;scales of the twelve numbers that are sent
    pl.sr[.i+3]=pl.so
    pl.sr[.i+6]=pl.sj
    pl.sr[.i+9]=pl.sj
  END
  FOR .i=0 TO 31
    $pl.ring[.i]="" ;packets
    pl.ringc[.i]=-1 ;pl.lost when it came
  END
  $pl.gap=$LEFT(" ",pl.w-6) ;after each number
  $pl.gaps=$LEFT("         ",9*(pl.w-6)) ;of a packet
.END
.PROGRAM pl.take() ;one command. 1 to 3 move at once: they end the motion and force feedback before
  .$q=$pl.ring[pl.rt]
  .c=pl.ringc[pl.rt]
  pl.rt=(pl.rt+1) MOD 32
  IF .c<>pl.lost GOTO done
  FOR .i=0 TO 8
    .v[.i]=VAL($MID(.$q,pl.w*.i+1,6)) ;ID, Com, Param, Vec1 to Vec6
  END
  pl.taken=.v[0]
  pl.tkc=.c
  IF (.v[1]==4) OR (.v[1]==5) OR (.v[1]==6) GOTO obey
  IF (.v[1]==7) AND ((pl.mode<>0) OR (.v[2]==2)) GOTO obey
  pl.mode=0
  pl.new=0
  BRAKE
obey:
  CASE .v[1] OF
  VALUE 1: ;a) to a pose
    POINT pl.p=TRANS(.v[3]/pl.sp,.v[4]/pl.sp,.v[5]/pl.sp,.v[6]/pl.so,.v[7]/pl.so,.v[8]/pl.so)
    SPEED pl.v MM/S
    CALL pl.turn
    IF pl.lost<>.c GOTO done
    LMOVE pl.p
  VALUE 2: ;b) to joint angles
    FOR .i=1 TO 6
      .x[.i]=.v[.i+2]/pl.sj
    END
    GOTO joints
  VALUE 3: ;c) by joint rotations, from where the joints are
    BREAK
    HERE #pl.j
    DECOMPOSE .x[1]=#pl.j
    FOR .i=1 TO 6
      .x[.i]=.x[.i]+.v[.i+2]/pl.sj
    END
    GOTO joints
  VALUE 4: ;d) reading of the sensor, base axes
    FOR .i=1 TO 3
      pl.f[.i]=.v[.i+2]/pl.sf
      pl.f[.i+3]=.v[.i+5]/pl.sm
    END
    pl.new=ABS(pl.mode<>0)
  VALUE 5: ;e) accelerations, and mechanical times modular speed
    ACCEL .v[3]/pl.sc ALWAYS
    DECEL .v[4]/pl.sc ALWAYS
    pl.v=.v[6]/pl.sv*.v[5]/pl.sc/100
    SPEED pl.v MM/S ALWAYS
  VALUE 6: ;f) gains
    FOR .i=1 TO 6
      IF .v[2]==0 THEN
        pl.kp[.i]=.v[.i+2]/pl.sg
      ELSE
        pl.ki[.i]=.v[.i+2]/pl.si
      END
    END
  VALUE 7: ;g) force feedback: 0 ForceFeedBackPosition, 1 ForceFeedBackOrientation, 2 stop
    IF .v[2]==2 THEN
      pl.mode=0
      pl.new=0
      RETURN
    END
    IF pl.mode==0 THEN
      BREAK
      HERE pl.p
      POINT pl.s0=pl.p
      pl.tnext=0
      pl.short=0
    END
    pl.mode=pl.mode BOR (.v[2]+1)
    pl.first=1
  END
done:
  RETURN
joints:
  POINT #pl.j=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
  CALL pl.jpace
  IF pl.lost<>.c GOTO done
  JMOVE #pl.j
.END
.PROGRAM pl.turn() ;where a turn takes longer than the way, MM/S alone would not limit it
  HERE pl.from
  CALL pl.angle(.a)
  IF .a*pl.lever>DISTANCE(pl.from,pl.p) THEN
    SPEED MINVAL(3600,MAXVAL(0.1,.a*pl.lever/pl.v)) S ;what SPEED takes
  END
.END
.PROGRAM pl.angle(.a) ;the turn from pl.from to pl.p [deg]
  POINT .m=-pl.from
  POINT .d=.m+pl.p
  DECOMPOSE .x[1]=.d
  .s=COS(.x[5]/2)*SIN((.x[4]+.x[6])/2)
  .a=2*ATAN2(SQRT(SIN(.x[5]/2)*SIN(.x[5]/2)+.s*.s),ABS(COS(.x[5]/2)*COS((.x[4]+.x[6])/2)))
.END
.PROGRAM pl.jpace() ;in percent: JMOVE takes MM/S for a share, and seconds may not be kept
  HERE .p
  HERE .#a
  DECOMPOSE .a[1]=.#a
  DECOMPOSE .b[1]=#pl.j
  .t=0
  .f=0 ;time that the joints need at 100 %
  FOR .i=1 TO 6
    .b[.i]=.b[.i]-.a[.i]
    .t=MAXVAL(.t,ABS(.b[.i])*pl.lever)
    .f=MAXVAL(.f,ABS(.b[.i])/pl.jmax[.i])
  END
  .s=0
  FOR .i=1 TO 8 ;the way of the flange is bent: the longest of eight stretches counts
    FOR .j=1 TO 6
      .x[.j]=.a[.j]+.i/8*.b[.j]
    END
    POINT .#q=#PPOINT(.x[1],.x[2],.x[3],.x[4],.x[5],.x[6])
    POINT .c=.#q
    .s=MAXVAL(.s,8*DISTANCE(.p,.c))
    POINT .p=.c
  END
  .t=MAXVAL(0.1,.s/pl.v,.t/pl.v)
  SPEED MINVAL(100,MAXVAL(0.01,100*.f/.t)) ;what SPEED takes
.END
.PROGRAM pl.step() ;an iteration of force feedback for the newest reading
  pl.new=0
  IF (pl.first<>0) OR (pl.t0>300) THEN ;nothing to compare with, no time to integrate over
    pl.first=0
    FOR .i=1 TO 6
      pl.fb[.i]=pl.f[.i]
    END
    TIMER 1=0
    pl.t0=0
    RETURN
  END
  IF pl.short<>0 THEN
    BREAK
    pl.short=0
  END
  .t=TIMER(1)
  .dt=MINVAL(.t-pl.t0,pl.dtmax)
  pl.t0=.t
  IF pl.mode<>2 THEN
    CALL forcefeedbackpo(.dt)
  END
  IF pl.mode>1 THEN
    CALL forcefeedbackor(.dt)
  END
  CALL pl.pace(.few)
  IF (.few<>0) OR (pl.lost<>pl.seen) GOTO done ;too little: it is added to the next one
  LMOVE pl.p
  WAIT (DISTANCE(DEST,pl.s0)<0.002) OR (pl.lost<>pl.seen) OR (TIMER(3)>1)
  TIMER 3=0
done:
  RETURN
.END
.PROGRAM pl.pace(.few) ;SPEED from pl.s0 to pl.p; .few=1: too little to move. As in forcemesh.as
  .a=0
  IF pl.mode>1 THEN
    POINT pl.from=pl.s0
    CALL pl.angle(.a)
  END
  .m=MAXVAL(MSPEED,1)/100 ;what the pendant leaves of pl.v; the time of a segment stays
  .s=DISTANCE(pl.s0,pl.p)
  .t=MAXVAL(1.02*pl.tmove,.s/(pl.v*.m),.a*pl.lever/(pl.v*.m))
  .few=0
  IF .s>=pl.vmin*.t*.m GOTO way
  IF .a*pl.lever>MAXVAL(.s,0.02) GOTO turn
  .few=ABS((.s<0.003) OR (TIMER(3)<0.3))
  IF .few<>0 GOTO done
  SPEED pl.vmin MM/S
  pl.short=1
  GOTO given
turn: ;no travel that MM/S could time
  .t=MAXVAL(.t,0.1/.m)
  SPEED .t*.m S
  GOTO given
way:
  SPEED .s/(.t*.m) MM/S
given:
  pl.tnext=.t
  POINT pl.s0=pl.p
  TIMER 3=0
done:
  RETURN
.END
.PROGRAM forcefeedbackpo(.dt) ;ForceFeedBackPosition: forces to zero by displacing along x, y, z
  FOR .i=1 TO 3
    .d[.i]=pl.kp[.i]*(pl.f[.i]-pl.fb[.i])+pl.ki[.i]*pl.f[.i]*.dt
    pl.fb[.i]=pl.f[.i]
  END
  POINT pl.p=SHIFT(pl.p BY .d[1],.d[2],.d[3])
.END
.PROGRAM forcefeedbackor(.dt) ;ForceFeedBackOrientation: moments to zero, base axes
  FOR .i=4 TO 6
    .d[.i]=pl.kp[.i]*(pl.f[.i]-pl.fb[.i])+pl.ki[.i]*pl.f[.i]*.dt
    pl.fb[.i]=pl.f[.i]
  END
  .s=SQRT(.d[4]*.d[4]+.d[5]*.d[5])
  .a=SQRT(.s*.s+.d[6]*.d[6])
  IF .a<0.00001 GOTO done
  .o=ATAN2(.d[5],.d[4]) ;the axis, as O and A of a z axis along it
  .q=ATAN2(.s,.d[6])
  POINT .u=TRANS(0,0,0,.o,.q,0)
  POINT .m=-.u
  POINT .c=pl.p+pl.tcp
  DECOMPOSE .x[1]=.c
  POINT .b=TRANS(.x[1],.x[2],.x[3])
  POINT .n=-.b
  POINT pl.p=.b+.u+RZ(.a)+.m+.n+pl.p
done:
  RETURN
.END
.PROGRAM pl.send() ;PC program 1, process 1: pose and joints without end
again:
  pl.busy=0
  TWAIT pl.tsend
  IF pl.link==0 GOTO again
  HERE .#j
  HERE .p
  DECOMPOSE .x[1]=.p
  DECOMPOSE .x[7]=.#j
  IF MINVAL(.x[1],.x[2],.x[3])*pl.sp<-99999 GOTO misfit
  IF MINVAL(.x[7],.x[8],.x[9],.x[10],.x[11],.x[12])*pl.sj<-99999 GOTO misfit
  .t=pl.taken*ABS(pl.tkc==pl.lost)
  $pl.t[1]=$RIGHT($ENCODE(/I7,1E6+.t),6)+$pl.gap+"000101"+$pl.gap+"000000"+$pl.gap
  $pl.t[8]=$RIGHT($ENCODE(/I7,1E6+pl.framed),6)+$pl.gap+"000102"+$pl.gap+"000000"+$pl.gap
  FOR .i=1 TO 12 ;a sign and five digits, or six digits: made without the options /K and /L
    .m=ABS(.x[.i]<0)
    .$n=$RIGHT($ENCODE(/I7,1E6+ROUND(ABS(.x[.i])*pl.sr[.i])),6-.m)
    $pl.t[.i+1+ABS(.i>6)]=$LEFT("-",.m)+.$n+$pl.gap
  END
  pl.busy=1
  IF pl.link==0 GOTO again
  TCP_SEND .r,pl.sock,$pl.t[1],14,1
  IF .r<0 THEN ;part of a packet may be out
    pl.drop=pl.lost
    pl.busy=0
    WAIT pl.link==0
  END
  GOTO again
misfit: ;never clipped: no packet at all
  TYPE "plain: a pose or joint does not fit into six characters, lower its scale"
  TWAIT 1
  GOTO again
.END
.PROGRAM pl.recv() ;PC program 2, process 2: characters to a buffer, the buffer to packets
  .w=pl.w
  .g=.w-6
  .$d="-0123456789"
listen:
  TCP_LISTEN .r,pl.port
  IF .r<0 THEN
    TCP_END_LISTEN .r,pl.port
    TWAIT 1
    GOTO listen
  END
accept:
  TCP_ACCEPT .s,pl.port,1
  IF .s==-34024 GOTO accept ;no client
  IF .s<=0 THEN
    TCP_END_LISTEN .r,pl.port
    TWAIT 1
    GOTO listen
  END
  pl.sock=.s
  pl.framed=0
  .$b=""
  pl.link=1
receive:
  .n=0
  TCP_RECV .r,pl.sock,$pl.rx[1],.n,1,189
  IF pl.drop==pl.lost GOTO lost
  IF .r==-34024 GOTO receive ;silence is no fault here
  IF (.r<>0) OR (.n<1) GOTO lost ;closed, or broken
  .i=1
join:
  .$b=.$b+$pl.rx[.i] ;at most 62 characters of before and 189
cut:
  IF LEN(.$b)<9*.w GOTO more
  .$q=$LEFT(.$b,9*.w)
  .$b=$MID(.$b,9*.w+1)
  .a=MINVAL(INSTR(.$d,$MID(.$q,1,1)),INSTR(.$d,$MID(.$q,.w+1,1)),INSTR(.$d,$MID(.$q,2*.w+1,1)))
  .e=MINVAL(INSTR(.$d,$MID(.$q,3*.w+1,1)),INSTR(.$d,$MID(.$q,4*.w+1,1)))
  .f=MINVAL(INSTR(.$d,$MID(.$q,5*.w+1,1)),INSTR(.$d,$MID(.$q,6*.w+1,1)))
  .h=MINVAL(INSTR(.$d,$MID(.$q,7*.w+1,1)),INSTR(.$d,$MID(.$q,8*.w+1,1)))
  IF (MINVAL(.a,.e,.f,.h)<1) OR (INSTR(.$q,"E")>0) GOTO wrong
  .a=MINVAL(VAL("1"+$MID(.$q,2,5)),VAL("1"+$MID(.$q,.w+2,5)),VAL("1"+$MID(.$q,2*.w+2,5)))
  .e=MINVAL(VAL("1"+$MID(.$q,3*.w+2,5)),VAL("1"+$MID(.$q,4*.w+2,5)))
  .f=MINVAL(VAL("1"+$MID(.$q,5*.w+2,5)),VAL("1"+$MID(.$q,6*.w+2,5)))
  .h=MINVAL(VAL("1"+$MID(.$q,7*.w+2,5)),VAL("1"+$MID(.$q,8*.w+2,5)))
  IF MINVAL(.a,.e,.f,.h)<100000 GOTO wrong
  .$g=$MID(.$q,7,.g)+$MID(.$q,.w+7,.g)+$MID(.$q,2*.w+7,.g)+$MID(.$q,3*.w+7,.g)
  .$g=.$g+$MID(.$q,4*.w+7,.g)+$MID(.$q,5*.w+7,.g)+$MID(.$q,6*.w+7,.g)+$MID(.$q,7*.w+7,.g)
  .$g=.$g+$MID(.$q,8*.w+7,.g)
  IF .$g<>$pl.gaps GOTO wrong
  .a=VAL($LEFT(.$q,6)) ;ID, from 1
  .e=VAL($MID(.$q,.w+1,6)) ;Com, 1 to 7
  .f=VAL($MID(.$q,2*.w+1,6)) ;Param: 0; 0 and 1 of command 6; 0, 1 and 2 of command 7
  IF (.a<1) OR (.e<1) OR (.e>7) OR (.f<0) OR (.f>MAXVAL(0,.e-5)) GOTO wrong
  .h=(pl.rh+1) MOD 32
  IF .h==pl.rt GOTO full
  $pl.ring[pl.rh]=.$q
  pl.ringc[pl.rh]=pl.lost
  pl.rh=.h
  pl.framed=.a
  GOTO cut
more:
  IF .i>=.n GOTO receive
  .i=.i+1
  GOTO join
full:
  TYPE "plain: 32 commands wait and pl.main takes none, connection closed"
  GOTO lost
wrong: ;never guess a new start: the connection ends
  TYPE "plain: not a packet of commands 1 to 7, connection closed: ",.$q
lost: ;the arm stops; pl.main brakes once more, for a motion that began meanwhile
  pl.link=0
  pl.lost=pl.lost+1
  FOR .i=1 TO 10 ;the controller may keep the motions behind the one that is braked
    BRAKE
    TWAIT 0.02
  END
  TCP_CLOSE .r,pl.sock
  IF .r<0 THEN ;the second call forces it
    TCP_CLOSE .r,pl.sock
  END
  TIMER 2=0
  WAIT (pl.busy==0) OR (TIMER(2)>3) ;the next socket may get the same number
  pl.sock=0
  GOTO accept
  ; A number is right when a sign or digit leads and "1" with the other five is 100000 or more:
  ; anything but a digit would end the number for VAL before, and an E make a power of ten.
.END
